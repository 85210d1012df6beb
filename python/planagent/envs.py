"""Environments of gymnasium: `planagent/Trajectory-v0` and `planagent/Code-v0`.

>>> import gymnasium, planagent.envs
>>> environment = gymnasium.make("planagent/Code-v0", scenarios=["generated/changing_lane/2"])
>>> observation, info = environment.reset(seed=1)
>>> observation, reward, terminated, truncated, info = environment.step({"centerline": 0, "speed": 10, "accelerations": 0})
>>> observation.shape, reward > 0
((97,), True)
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _core
from ._arguments import many, text, whole, wrong
from ._extras import installed
from ._features import FEATURES, Feature
from ._observation import Observation
from ._scenario import Scenario, opened
from .errors import ArgumentError

installed("gymnasium", "planagent.envs")
import gymnasium  # noqa: E402
from gymnasium import spaces  # noqa: E402
from gymnasium.vector import AutoresetMode  # noqa: E402
from gymnasium.vector.utils import batch_space  # noqa: E402

__all__ = [
    "FEATURES",
    "CodeEnv",
    "CodeVectorEnv",
    "Feature",
    "TrajectoryEnv",
    "TrajectoryVectorEnv",
    "register",
]

#: What is simulated where no scenario is named: one of each of some types.
DEFAULT_SCENARIOS = (
    "generated/changing_lane/2",
    "generated/following_lane_with_lead/2",
    "generated/stopping_with_lead/2",
    "generated/traversing_roundabout/2",
)
#: Poses of an action of `Trajectory-v0`, and seconds between them.
POSES, POSE_DT_S = 8, 0.5
#: Bounds of a pose of an action relative to the ego: forward and left in meters, turn in radians.
POSE_HIGH = (160.0, 80.0, np.pi)
POSE_LOW = (-20.0, -80.0, -np.pi)
#: Values of the three parts of an action of `Code-v0`.
CODE = {"centerline": 3, "speed": 11, "accelerations": 4}
#: Steps of 0.1 s that an action lasts: a code lasts two seconds, as the paper's.
TRAJECTORY_STEPS, CODE_STEPS = 1, 20
#: Most episodes that step together: each holds a scene of its own in memory.
MAX_ENVS = 10_000
#: Largest seed.
MAX_SEED = 2**64 - 1
#: Time that the plan of a code reaches, and a step, seconds.
CODE_S, STEP_S = 8.0, 0.1


#: Scenarios or their names; one or several.
Scenarios = Union[str, os.PathLike[str], Scenario, Iterable[Union[str, os.PathLike[str], Scenario]]]


class _Rules:
    """What both environments have in common."""

    def __init__(
        self,
        scenarios: Scenarios,
        challenge: str,
        count: int,
        steps: int,
        pose_dt_s: float | None,
    ) -> None:
        longest = round((CODE_S if pose_dt_s is None else POSES * pose_dt_s) / STEP_S) - 1
        steps = whole("steps", steps)
        if not 1 <= steps <= longest:
            raise ArgumentError(f"an action lasts 1 to {longest} steps, got {steps}")
        kinds = (str, os.PathLike, Scenario)
        named = many("scenarios", scenarios, kinds, "a Scenario or the name of one")
        if not named:
            raise wrong("scenarios", named, "an environment needs a scenario")
        self.count = whole("num_envs", count, 1, MAX_ENVS)
        self.scenarios = [opened("scenarios", one) for one in named]
        native = [scenario._native for scenario in self.scenarios]
        self.native = _core.Vector(native, text("challenge", challenge), self.count, steps, pose_dt_s)
        # Environments without a seed differ, as those of gymnasium do.
        self.native.reset([secrets.randbits(63) for _ in range(self.count)], None)

    def reset(
        self, seeds: Sequence[int | None], options: Mapping[str, Any] | None
    ) -> tuple[NDArray[np.float32], list[str]]:
        scenario = None
        if options is not None and not isinstance(options, Mapping):
            raise wrong("options", options, "expected a dictionary")
        for key in options or {}:
            if key != "scenario":
                raise wrong("options", options, f"the option {key!r} is unknown; there is 'scenario'")
        chosen = (options or {}).get("scenario")
        if chosen is not None:
            chosen = chosen.id if isinstance(chosen, Scenario) else chosen
            names = [one.id for one in self.scenarios]
            if chosen not in names:
                raise wrong("options['scenario']", chosen, f"expected one of {', '.join(names)}")
            scenario = names.index(chosen)
        return self.observations(self.native.reset(list(seeds), scenario)), self.ids()

    def infos(self) -> dict[str, Any]:
        """What is beside the observations: a value for each episode."""
        numbers, speeds, iterations, collisions, off_road, scores = self.native.infos()
        return {
            "scenario": [self.scenarios[number].id for number in numbers],
            "speed": np.array(speeds),
            "iteration": np.array(iterations),
            "collision": np.array(collisions, dtype=np.bool_),
            "off_road": np.array(off_road, dtype=np.bool_),
            "score": np.array([np.nan if score is None else score for score in scores]),
        }

    def info(self) -> dict[str, Any]:
        """The same of one episode. A score that is not there yet is None: NaN is unequal to itself, so two equal steps would differ."""
        infos = {name: values[0] for name, values in self.infos().items()}
        plain = {name: value.item() if isinstance(value, np.generic) else value for name, value in infos.items()}
        return {**plain, "score": None if np.isnan(plain["score"]) else plain["score"]}

    def ids(self) -> list[str]:
        return [self.scenarios[number].id for number in self.native.scenarios()]

    def observations(self, data: bytearray) -> NDArray[np.float32]:
        return np.frombuffer(data, dtype=np.float32).reshape(self.count, -1)

    def step(
        self, actions: NDArray[np.float64]
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        data, rewards, terminated, truncated = self.native.step(np.ascontiguousarray(actions).tobytes())
        return (
            self.observations(data),
            np.frombuffer(rewards, dtype=np.float64),
            np.frombuffer(terminated, dtype=np.bool_),
            np.frombuffer(truncated, dtype=np.bool_),
        )


def _observation_space() -> Any:
    return spaces.Box(-np.inf, np.inf, (_core.Vector.OBSERVATION,), np.float32)


def _poses_space() -> spaces.Box:
    low, high = (np.tile(np.array(bound, dtype=np.float32), (POSES, 1)) for bound in (POSE_LOW, POSE_HIGH))
    return spaces.Box(low, high, dtype=np.float32)


class _Form:
    """The form of an action that is a code."""

    def __init__(self, name: str) -> None:
        sizes = list(CODE.values())
        forms: dict[str, Any] = {
            "dict": lambda: spaces.Dict({name: spaces.Discrete(size) for name, size in CODE.items()}),
            "multi": lambda: spaces.MultiDiscrete(sizes),
            "discrete": lambda: spaces.Discrete(int(np.prod(sizes))),
        }
        if name not in forms:
            raise wrong("actions", name, f"expected one of {', '.join(forms)}")
        self.name, self.space = name, forms[name]()

    def numbers(self, actions: Any, count: int | None) -> NDArray[np.float64]:
        """The numbers of an action, or of `count` of them: a row each."""
        shape = () if count is None else (count,)
        if self.name == "dict":
            if not isinstance(actions, Mapping) or set(actions) != set(CODE):
                raise wrong("the action", actions, f"expected the keys {', '.join(CODE)}")
            parts = [_whole_numbers(name, actions[name], shape, size) for name, size in CODE.items()]
        elif self.name == "multi":
            values = _arrays.array("the action", actions, f"expected the shape {(*shape, len(CODE))}")
            if values.shape != (*shape, len(CODE)):
                raise wrong("the action", actions, f"expected the shape {(*shape, len(CODE))}, got {values.shape}")
            parts = [_whole_numbers(name, values[..., i], shape, size) for i, (name, size) in enumerate(CODE.items())]
        else:
            left = _whole_numbers("the action", actions, shape, int(self.space.n))
            parts = []
            for size in reversed(CODE.values()):
                left, part = np.divmod(left, size)
                parts.insert(0, part)
        return np.stack(parts, axis=-1).astype(np.float64)


def _whole_numbers(name: str, values: Any, shape: tuple[int, ...], size: int) -> NDArray[np.int64]:
    """Whole numbers below a size, checked."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise wrong(name, values, f"this is no code; expected whole numbers from 0 to {size - 1}") from None
    if array.shape != shape:
        raise wrong(name, values, f"expected the shape {shape}, got {array.shape}")
    if not ((array == np.floor(array)) & (array >= 0) & (array < size)).all():
        raise wrong(name, values, f"this is no code; expected whole numbers from 0 to {size - 1}")
    return array.astype(np.int64)


def _poses(actions: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """The poses of an action for each episode."""
    poses = _arrays.poses(actions, len(shape))
    if poses.shape != shape:
        raise ArgumentError(f"expected actions of the shape {shape}, got {poses.shape}")
    return poses


class _Env(gymnasium.Env[NDArray[np.float32], Any]):
    """One episode."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}

    def __init__(self, rules: _Rules, action_space: spaces.Space[Any], render_mode: str | None) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise wrong("render_mode", render_mode, "expected 'rgb_array' or None")
        self._rules = rules
        self.observation_space = _observation_space()
        self.action_space = action_space
        self.render_mode = render_mode
        self._is_ended = True

    def _action(self, action: Any) -> NDArray[np.float64]:
        raise NotImplementedError

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins an episode; `options={"scenario": ID}` chooses its scenario, else `seed` does."""
        seed = None if seed is None else whole("seed", seed, 0, MAX_SEED)
        super().reset(seed=seed)
        observations, _ = self._rules.reset([seed], options)
        self._is_ended = False
        return observations[0], self._rules.info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One action."""
        if self._is_ended:
            raise gymnasium.error.ResetNeeded("the episode is over; call reset")
        observations, rewards, terminated, truncated = self._rules.step(self._action(action))
        self._is_ended = bool(terminated[0] or truncated[0])
        return observations[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), self._rules.info()

    def observe(self) -> Observation:
        """What a planner would see now: the picture, the lane graph, the objects."""
        return Observation._of(self._rules.native.observe(0))

    def render(self) -> Any:
        """The scene as a picture, with the render mode `rgb_array`."""
        return self.observe().render() if self.render_mode == "rgb_array" else None


class TrajectoryEnv(_Env):
    """Acts by trajectories: 8 poses 0.5 s apart, relative to the ego (forward and left in meters, turn in radians).

    The observation has 97 numbers, which `FEATURES` names with unit and scale: 5 of the ego, 10 points of the route's centerline, and 9
    numbers of each of the 8 nearest objects. `info` has the scenario, the speed in m/s, the iteration, whether the ego collided or left the
    road, and nuPlan's score at the end of the scenario (None before). The reward is 0.1 for a meter of progress along the route, and -10 for a collision or an ego off the road, which
    end the episode. It is truncated at the end of the scenario.

    Parameters
    ----------
    scenarios
        Scenarios or their names; the seed of `reset` chooses one.
    challenge
        `reactive` or `nonreactive`.
    steps
        Steps of 0.1 s for each action.
    render_mode
        `rgb_array` or `None`.

    Examples
    --------
    >>> import numpy as np, planagent.envs
    >>> environment = planagent.envs.TrajectoryEnv("generated/changing_lane/2")
    >>> observation, info = environment.reset(seed=0)
    >>> ahead = np.column_stack([10 * 0.5 * np.arange(1, 9), np.zeros(8), np.zeros(8)])
    >>> observation, reward, terminated, truncated, info = environment.step(ahead)
    >>> info["iteration"], terminated
    (1, False)
    """

    def __init__(
        self,
        scenarios: Scenarios = DEFAULT_SCENARIOS,
        challenge: str = "reactive",
        steps: int = TRAJECTORY_STEPS,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(_Rules(scenarios, challenge, 1, steps, POSE_DT_S), _poses_space(), render_mode)

    def _action(self, action: Any) -> NDArray[np.float64]:
        return _poses(action, (POSES, 3))


class CodeEnv(_Env):
    """Acts by planner codes: a centerline, tenths of the speed limit, and one of four pairs of accelerations.

    Observation, reward and parameters are those of `TrajectoryEnv`; an action lasts 2 s. Where the scene has no such centerline,
    the ego's lane is followed.

    Parameters
    ----------
    actions
        The form of an action: `dict` has the keys `centerline`, `speed` and `accelerations`; `multi` is a `MultiDiscrete` of the same
        three numbers, and `discrete` one number of 132, both of which libraries of learning take.

    Examples
    --------
    >>> import planagent.envs
    >>> environment = planagent.envs.CodeEnv("generated/changing_lane/2", actions="multi")
    >>> observation, info = environment.reset(seed=0)
    >>> observation, reward, terminated, truncated, info = environment.step([0, 10, 0])
    >>> info["collision"], info["speed"] > 0
    (False, True)
    """

    def __init__(
        self,
        scenarios: Scenarios = DEFAULT_SCENARIOS,
        challenge: str = "reactive",
        steps: int = CODE_STEPS,
        render_mode: str | None = None,
        actions: str = "dict",
    ) -> None:
        self._form = _Form(actions)
        super().__init__(_Rules(scenarios, challenge, 1, steps, None), self._form.space, render_mode)

    def _action(self, action: Any) -> NDArray[np.float64]:
        return self._form.numbers(action, None)


class _VectorEnv(gymnasium.vector.VectorEnv[NDArray[np.float32], Any, NDArray[np.float64]]):
    """Many episodes that step together in the native half."""

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}

    def __init__(self, rules: _Rules, action_space: spaces.Space[Any]) -> None:
        self._rules = rules
        self.num_envs = rules.count
        self.single_observation_space = _observation_space()
        self.single_action_space = action_space
        self.observation_space = batch_space(self.single_observation_space, rules.count)
        self.action_space = batch_space(action_space, rules.count)

    def _actions(self, actions: Any) -> NDArray[np.float64]:
        raise NotImplementedError

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins all episodes; a number seeds them by it and the following ones."""
        seeds: list[int | None]
        if seed is None:
            seeds = [None] * self.num_envs
        elif isinstance(seed, Iterable):
            seeds = [None if one is None else whole("seed", one, 0, MAX_SEED) for one in seed]
            if len(seeds) != self.num_envs:
                raise wrong("seed", seeds, f"expected a number or {self.num_envs} of them")
        else:
            first = whole("seed", seed, 0, MAX_SEED - self.num_envs)
            seeds = [first + i for i in range(self.num_envs)]
        super().reset(seed=seeds[0])
        observations, _ = self._rules.reset(seeds, options)
        return observations, self._rules.infos()

    def step(  # type: ignore[override]
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One action for each episode."""
        return (*self._rules.step(self._actions(actions)), self._rules.infos())


class TrajectoryVectorEnv(_VectorEnv):
    """`TrajectoryEnv` for many episodes at once.

    Examples
    --------
    >>> import gymnasium, planagent.envs
    >>> vector = gymnasium.make_vec("planagent/Trajectory-v0", num_envs=4, vectorization_mode="vector_entry_point")
    >>> observations, info = vector.reset(seed=0)
    >>> observations.shape
    (4, 97)
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenarios: Scenarios = DEFAULT_SCENARIOS,
        challenge: str = "reactive",
        steps: int = TRAJECTORY_STEPS,
    ) -> None:
        super().__init__(_Rules(scenarios, challenge, num_envs, steps, POSE_DT_S), _poses_space())

    def _actions(self, actions: Any) -> NDArray[np.float64]:
        return _poses(actions, (self.num_envs, POSES, 3))


class CodeVectorEnv(_VectorEnv):
    """`CodeEnv` for many episodes at once.

    Examples
    --------
    >>> import numpy as np, planagent.envs
    >>> environments = planagent.envs.CodeVectorEnv(2, "generated/changing_lane/2", actions="multi")
    >>> observations, infos = environments.reset(seed=0)
    >>> observations, rewards, terminated, truncated, infos = environments.step(np.array([[0, 10, 0], [0, 0, 0]]))
    >>> bool(infos["speed"][0] > infos["speed"][1])
    True
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenarios: Scenarios = DEFAULT_SCENARIOS,
        challenge: str = "reactive",
        steps: int = CODE_STEPS,
        actions: str = "dict",
    ) -> None:
        self._form = _Form(actions)
        super().__init__(_Rules(scenarios, challenge, num_envs, steps, None), self._form.space)

    def _actions(self, actions: Any) -> NDArray[np.float64]:
        return self._form.numbers(actions, self.num_envs)


def register() -> None:
    """Registers the environments, as the import of this module does.

    Examples
    --------
    >>> import gymnasium, planagent.envs
    >>> planagent.envs.register()
    >>> "planagent/Code-v0" in gymnasium.registry
    True
    """
    for name, single, vector in (
        ("planagent/Trajectory-v0", "TrajectoryEnv", "TrajectoryVectorEnv"),
        ("planagent/Code-v0", "CodeEnv", "CodeVectorEnv"),
    ):
        if name not in gymnasium.registry:
            gymnasium.register(
                name, entry_point=f"planagent.envs:{single}", vector_entry_point=f"planagent.envs:{vector}"
            )


register()
