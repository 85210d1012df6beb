"""Simulations that Python steps."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _core
from ._arguments import seconds, text, whole
from ._observation import EgoState, Observation, Trajectory
from ._planners import Agent, as_factory
from ._scenario import Scenario, opened

__all__ = ["Score", "Simulation"]


@dataclass(frozen=True)
class Score:
    """nuPlan's score of a simulation.

    Attributes
    ----------
    value : float
        In [0, 1]: the product of the multipliers times the weighted average.
    multiplier, weighted_average : float
        Its two factors.
    parts : dict
        nuPlan's name of each metric in the score to its score.
    roles : dict
        The same names to `multiplier` or `weight W`.
    metrics : dict
        All metrics to their scores; `None` for one that has none.

    Examples
    --------
    >>> import planagent
    >>> score = planagent.Simulation("generated/changing_lane/2").run("pdm-closed").score()
    >>> float(score) == score.value, score.roles["no_ego_at_fault_collisions"]
    (True, 'multiplier')
    """

    value: float
    multiplier: float
    weighted_average: float
    parts: dict[str, float]
    roles: dict[str, str]
    metrics: dict[str, float | None]

    def __float__(self) -> float:
        return self.value


class Simulation:
    """A closed loop at 10 Hz, as nuPlan's: an LQR tracker follows the trajectories, agents replay the log or follow IDM.

    Parameters
    ----------
    scenario
        A scenario or its name.
    challenge
        `nonreactive`, `reactive` or `open-loop`.

    Examples
    --------
    >>> import planagent
    >>> simulation = planagent.Simulation("generated/changing_lane/2", "reactive")
    >>> observation = simulation.reset()
    >>> while not simulation.is_over:
    ...     observation = simulation.step(observation.code())
    >>> 0 <= simulation.score().value <= 1
    True
    """

    __slots__ = ("_native", "scenario")

    def __init__(self, scenario: Scenario | str | os.PathLike[str], challenge: str = "nonreactive") -> None:
        #: The scenario.
        self.scenario = opened("scenario", scenario)
        self._native = _core.Simulation(self.scenario._native, text("challenge", challenge))

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        # The plans that were followed lead to the same state again.
        plans = [Trajectory._of(self._native.plan_at(i)) for i in range(self.iteration)]
        return _replayed, (self.scenario, self.challenge, plans)

    def __repr__(self) -> str:
        last = self._native.iterations - 1
        return f"Simulation({self.scenario.id!r}, {self.challenge!r}, iteration={self.iteration} of {last})"

    @property
    def challenge(self) -> str:
        """`nonreactive`, `reactive` or `open-loop`."""
        return self._native.challenge

    @property
    def iteration(self) -> int:
        """The present iteration, from 0."""
        return self._native.iteration

    @property
    def is_over(self) -> bool:
        """Whether the last iteration is reached."""
        return self._native.is_over

    def reset(self) -> Observation:
        """Starts again at iteration 0.

        Examples
        --------
        >>> import planagent
        >>> simulation = planagent.Simulation("generated/changing_lane/2").run("idm", steps=3)
        >>> simulation.reset().iteration
        0
        """
        self._native.reset()
        return self.observe()

    def observe(self) -> Observation:
        """What a planner sees now.

        Examples
        --------
        >>> import planagent
        >>> planagent.Simulation("generated/changing_lane/2").run("idm", steps=3).observe().iteration
        3
        """
        return Observation._of(self._native.observe())

    def step(self, plan: Trajectory | ArrayLike, dt: float = 0.1) -> Observation:
        """Moves to the next iteration: the ego along a trajectory, the agents as the challenge says.

        Parameters
        ----------
        plan
            A `Trajectory`, or T x 3 numbers: x, y, heading of the rear axle in the map frame, the first `dt` after the
            present. Nothing but the poses is followed.
        dt
            Seconds between two poses of an array.

        Raises
        ------
        ArgumentError
            Where the plan does not begin at the ego, or jumps; poses relative to the ego do.
        SimulationError
            Where the simulation is over or the trajectory cannot be tracked.

        Examples
        --------
        >>> import numpy as np, planagent
        >>> simulation = planagent.Simulation("generated/changing_lane/2")
        >>> stop = np.tile(simulation.observe().ego.pose, (40, 1))
        >>> simulation.step(stop).iteration
        1
        """
        if isinstance(plan, Trajectory):
            self._native.step(plan._native)
        else:
            self._native.step_poses(_arrays.poses(plan).tobytes(), seconds("dt", dt))
        return self.observe()

    def clone(self) -> Simulation:
        """A copy in the same state, to try several plans from one state.

        Examples
        --------
        >>> import planagent
        >>> simulation = planagent.Simulation("generated/changing_lane/2").run("idm", steps=3)
        >>> other = simulation.clone().run("idm", steps=1)
        >>> simulation.iteration, other.iteration
        (3, 4)
        """
        made = Simulation.__new__(Simulation)
        made.scenario, made._native = self.scenario, self._native.duplicate()
        return made

    __copy__ = clone

    def __deepcopy__(self, memo: dict[int, Any]) -> Simulation:
        return self.clone()

    def run(self, planner: Any, steps: int | None = None) -> Simulation:
        """Steps to the end with a planner.

        Parameters
        ----------
        planner
            The name of a planner of the library, an `Agent`, or a planner of your own: see `planagent.Planner`.
        steps
            Only so many steps.

        Returns
        -------
        Simulation
            This one.

        Examples
        --------
        >>> import planagent
        >>> planagent.Simulation("generated/changing_lane/2").run("pdm-closed").score().parts["no_ego_at_fault_collisions"]
        1.0
        """
        if steps is not None:
            steps = min(whole("steps", steps), self._native.iterations)
        if isinstance(planner, str):
            planner = Agent(planner=planner, scenario=self.scenario)
        if isinstance(planner, Agent):
            self._native.run(planner._native, steps)
            return self
        bound = as_factory(planner, "planner")()
        left = steps if steps is not None else self._native.iterations
        while left > 0 and not self.is_over:
            self._native.step(bound.plan(self._native.observe()))
            left -= 1
        return self

    def score(self) -> Score:
        """nuPlan's score; the simulation must be over.

        Examples
        --------
        >>> import planagent
        >>> planagent.Simulation("generated/changing_lane/2").run("log-replay").score().value > 0.5
        True
        """
        value, multiplier, average, parts, metrics = self._native.score()
        return Score(
            value,
            multiplier,
            average,
            {name: score for name, _, score in parts},
            {name: role for name, role, _ in parts},
            dict(metrics),
        )

    @property
    def ego_states(self) -> list[EgoState]:
        """The states of the ego so far, the present one last."""
        times, data = self._native.ego_states()
        rows = _arrays.unpacked(data, 11).tolist()
        return [EgoState(time, *row) for time, row in zip(times, rows)]

    @property
    def trail(self) -> NDArray[np.float64]:
        """x, y and heading of the rear axle so far."""
        _, data = self._native.ego_states()
        return _arrays.unpacked(data, 11)[:, :3].copy()


def _replayed(scenario: Scenario, challenge: str, plans: list[Trajectory]) -> Simulation:
    made = Simulation(scenario, challenge)
    for plan in plans:
        made._native.step(plan._native)
    return made
