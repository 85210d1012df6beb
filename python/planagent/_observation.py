"""What a planner sees, and what it answers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _arrays, _core
from ._arguments import real, seconds, text, whole, wrong
from .errors import ArgumentError

__all__ = ["EgoState", "Lane", "Observation", "Sample", "Trajectory", "TrajectoryScores"]

#: What the native half takes as a number of pixels; it says which of these are too many.
MAX_PIXELS = 2**32 - 1
#: Latest time of a trajectory, microseconds: thousands of years, so that no difference of two overflows.
MAX_TIME_US = 2**58


def _microseconds(name: str, value: Any) -> int:
    """A time; a number with a point has none behind it."""
    if isinstance(value, (float, np.floating)) and float(value).is_integer():
        value = int(value)
    return whole(name, value, -MAX_TIME_US, MAX_TIME_US)


class EgoState(NamedTuple):
    """State of the ego, referred to its rear axle.

    Attributes
    ----------
    time_us : int
        Time, microseconds.
    x, y, heading : float
        Pose of the rear axle in the map frame, meters and radians.
    vx, vy : float
        Velocity in the body frame (forward, left), m/s.
    ax, ay : float
        Acceleration in the body frame, m/s².
    steering_angle, steering_rate : float
        Of the front wheels, radians and rad/s.
    angular_velocity, angular_acceleration : float
        Yaw rate and its derivative, rad/s and rad/s².

    Examples
    --------
    >>> import planagent
    >>> ego = planagent.open("generated/changing_lane/2").observe().ego
    >>> ego.pose.shape, ego.speed == abs(complex(ego.vx, ego.vy))
    ((3,), True)
    """

    time_us: int
    x: float
    y: float
    heading: float
    vx: float
    vy: float
    ax: float
    ay: float
    steering_angle: float
    steering_rate: float
    angular_velocity: float
    angular_acceleration: float

    @classmethod
    def _of(cls, native: tuple[int, Sequence[float]]) -> EgoState:
        return cls(native[0], *native[1])

    @property
    def speed(self) -> float:
        """Norm of the velocity, m/s."""
        return float(np.hypot(self.vx, self.vy))

    @property
    def pose(self) -> NDArray[np.float64]:
        """x, y and heading."""
        return np.array([self.x, self.y, self.heading])


class Sample(NamedTuple):
    """The ego and the objects at an instant of the past.

    Examples
    --------
    >>> import planagent
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> observation.history[-1].ego == observation.ego
    True
    """

    ego: EgoState
    objects: NDArray[np.void]


@dataclass(frozen=True)
class Lane:
    """A lane, or a lane connector across an intersection.

    Attributes
    ----------
    id : int
        Its number in the map; `incoming`, `outgoing`, `left`, `right` and lights use it.
    centerline, polygon : numpy.ndarray
        Points x, y in the map frame, meters; the centerline in driving direction.
    speed_limit : float or None
        m/s.
    on_route : bool
        Whether it belongs to the route of the ego.

    Examples
    --------
    >>> import planagent
    >>> lane = planagent.open("generated/changing_lane/2").lanes()[0]
    >>> lane.id, lane.connector, lane.centerline.shape[1]
    (0, False, 2)
    """

    id: int
    source_id: int
    connector: bool
    on_route: bool
    speed_limit: float | None
    traffic_light: bool
    roadblock: int
    incoming: list[int]
    outgoing: list[int]
    left: list[int]
    right: list[int]
    centerline: NDArray[np.float64]
    polygon: NDArray[np.float64]

    @classmethod
    def _of(cls, native: dict[str, Any]) -> Lane:
        native["centerline"] = _arrays.unpacked(native["centerline"], 2)
        native["polygon"] = _arrays.unpacked(native["polygon"], 2)
        return cls(**native)


class Trajectory:
    """A path in time of the ego's rear axle.

    Parameters
    ----------
    poses
        x, y, heading in the map frame at each time.
    times_us
        Times in microseconds, growing; the first is that of the present.

    Examples
    --------
    >>> import planagent
    >>> plan = planagent.Trajectory([[0, 0, 0], [1, 0, 0]], [0, 100_000])
    >>> plan.at(50_000)
    array([0.5, 0. , 0. ])
    """

    __slots__ = ("_native",)

    def __init__(self, poses: ArrayLike, times_us: Sequence[int]) -> None:
        packed = _arrays.poses(poses).tobytes()
        times = [_microseconds(f"times_us[{i}]", time) for i, time in enumerate(times_us)]
        self._native = _core.Trajectory.of_times(times, packed)

    @classmethod
    def _of(cls, native: _core.Trajectory) -> Trajectory:
        made = cls.__new__(cls)
        made._native = native
        return made

    def __reduce__(self) -> tuple[type[Trajectory], tuple[NDArray[np.float64], list[int]]]:
        return Trajectory, (self.poses, self._native.times_us())

    def __len__(self) -> int:
        return len(self._native.times_us())

    def __repr__(self) -> str:
        times = self._native.times_us()
        seconds = (times[-1] - times[0]) / 1e6
        return f"Trajectory({len(times)} states over {seconds:g} s)"

    @property
    def times_us(self) -> NDArray[np.int64]:
        """Times, microseconds."""
        return np.array(self._native.times_us(), dtype=np.int64)

    @property
    def states(self) -> NDArray[np.float64]:
        """T x 8 numbers: x, y, heading, vx, vy, ax, ay, steering angle."""
        return _arrays.unpacked(self._native.states(), 8)

    @property
    def poses(self) -> NDArray[np.float64]:
        """T x 3 numbers: x, y, heading of the rear axle in the map frame."""
        return self.states[:, :3]

    def at(self, time_us: int) -> NDArray[np.float64]:
        """The interpolated pose at a time in microseconds.

        Examples
        --------
        >>> import planagent
        >>> planagent.Trajectory([[0, 0, 0], [2, 0, 0]], [0, 200_000]).at(100_000)
        array([1., 0., 0.])
        """
        pose: NDArray[np.float64] = _arrays.unpacked(self._native.at(_microseconds("time_us", time_us)), 3)[0].copy()
        return pose


@dataclass(frozen=True)
class TrajectoryScores:
    """Scores of N trajectories: PDM-Closed's measure, which Reflection uses.

    Attributes
    ----------
    score : numpy.ndarray
        The product of the first three parts times the weighted mean of the others, in [0, 1].
    no_collision, drivable_area, driving_direction : numpy.ndarray
        Factors: 1, 0.5 or 0.
    progress : numpy.ndarray
        Weight 5: progress relative to the best of PDM-Closed's proposals.
    time_to_collision : numpy.ndarray
        Weight 5: 1 where no collision is near at constant speed.
    comfort : numpy.ndarray
        Weight 2: 1 where all comfort bounds hold.
    progress_m : numpy.ndarray
        Progress along the centerline, meters.

    Examples
    --------
    >>> import planagent
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> scores = observation.score(observation.code().poses[None, 1:41])
    >>> scores.score.shape, scores.no_collision
    ((1,), array([1.]))
    """

    score: NDArray[np.float64]
    no_collision: NDArray[np.float64]
    drivable_area: NDArray[np.float64]
    driving_direction: NDArray[np.float64]
    progress: NDArray[np.float64]
    time_to_collision: NDArray[np.float64]
    comfort: NDArray[np.float64]
    progress_m: NDArray[np.float64]


class Observation:
    """The scene at one instant with its recent past; it holds no future.

    Observations come from `Scenario.observe` and `Simulation.observe`, and planners get them.

    Examples
    --------
    >>> import planagent
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> observation.ego.speed > 0
    True
    >>> observation.image().shape
    (128, 128, 3)
    """

    __slots__ = ("_native",)
    _native: _core.Observation

    def __init__(self) -> None:
        raise TypeError("observations come from Scenario.observe and Simulation.observe")

    @classmethod
    def _of(cls, native: _core.Observation) -> Observation:
        made = cls.__new__(cls)
        made._native = native
        return made

    def __reduce__(self) -> tuple[Any, tuple[bytes]]:
        return _observation, (self._native.to_bytes(),)

    def __copy__(self) -> Observation:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> Observation:
        # It never changes.
        return self

    def __repr__(self) -> str:
        return f"Observation(iteration={self.iteration}, objects={len(self.objects)})"

    @property
    def iteration(self) -> int:
        """The iteration, from 0; one every 0.1 s."""
        return self._native.iteration

    @property
    def time_s(self) -> float:
        """Seconds after iteration 0."""
        return self._native.time_s

    @property
    def ego(self) -> EgoState:
        """The ego now."""
        return EgoState._of(self._native.ego())

    @property
    def objects(self) -> NDArray[np.void]:
        """The objects now, a structured array.

        Its fields are `token`, `kind` (a number of `planagent.KINDS`), `x`, `y`, `heading`, `length`, `width`, `vx` and
        `vy`: the box and the velocity in the map frame.
        """
        return _arrays.objects(self._native.objects())

    @property
    def history(self) -> list[Sample]:
        """The last two seconds at 10 Hz, oldest first; the last one is the present."""
        return [Sample(EgoState._of(ego), _arrays.objects(data)) for ego, data in self._native.history()]

    @property
    def lights(self) -> dict[int, str]:
        """The traffic lights: number of the lane connector to `green`, `yellow`, `red` or `unknown`."""
        return dict(self._native.lights())

    @property
    def goal(self) -> tuple[float, float, float] | None:
        """x, y and heading of the mission goal."""
        return self._native.goal()

    @property
    def goal_lane(self) -> int | None:
        """Number of the lane that holds the goal, where the score asks for it: in a modified scenario with a goal."""
        return self._native.goal_lane()

    def lanes(self, within_m: float | None = 100.0) -> list[Lane]:
        """The lanes near the ego.

        Parameters
        ----------
        within_m
            Half the side of a square around the ego, meters; `None` for the whole map.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> len(observation.lanes(20.0)) < len(observation.lanes(None))
        True
        """
        if within_m is not None:
            try:
                # All of the map lies within infinity.
                within_m = None if float(within_m) == math.inf else real("within_m", within_m, 0.0)
            except (TypeError, ValueError):
                raise wrong("within_m", within_m, "expected a number of meters from 0 on, or None") from None
        return [Lane._of(lane) for lane in self._native.lanes(within_m)]

    def image(self, pixels: int = 128, meters: float = 64.0) -> NDArray[np.uint8]:
        """The bird's-eye-view picture that a model sees: the ego in its center, heading up.

        Returns
        -------
        numpy.ndarray
            Height x width x 3 numbers of type uint8.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> observation.image(pixels=64, meters=32.0).shape
        (64, 64, 3)
        """
        pixels, meters = whole("pixels", pixels, 1, MAX_PIXELS), real("meters", meters, 0.0, above=True)
        return _arrays.image(self._native.image(pixels, meters))

    def render(
        self, pixels: int = 560, meters: float = 80.0, plan: Trajectory | ArrayLike | None = None
    ) -> NDArray[np.uint8]:
        """A picture for people: map, route, lights, agents, and a plan.

        Parameters
        ----------
        pixels, meters
            Side of the picture.
        plan
            A trajectory to draw, as `Simulation.step` takes it.

        Returns
        -------
        numpy.ndarray
            Height x width x 3 numbers of type uint8.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> observation.render(pixels=200, plan=observation.code()).dtype
        dtype('uint8')
        """
        native = None if plan is None else self.trajectory(plan)._native
        pixels, meters = whole("pixels", pixels, 1, MAX_PIXELS), real("meters", meters, 0.0, above=True)
        return _arrays.image(self._native.render(pixels, meters, native))

    def lane_graph(self, form: str = "paper") -> str:
        """The lane graph in words.

        Parameters
        ----------
        form
            `paper`, in short English lines, or `compact-2`, as `nano` reads it.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> "Ego: " in observation.lane_graph()
        True
        """
        return self._native.lane_graph(text("form", form))

    def centerlines(self) -> list[str]:
        """The centerlines that a planner code may follow, `ego_lane` first.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> observation.centerlines()[0]
        'ego_lane'
        """
        return self._native.centerlines()

    def code(
        self,
        centerline: str = "ego_lane",
        speed: float = 1.0,
        accelerations: tuple[float, float] = (1.5, 3.0),
    ) -> Trajectory:
        """The trajectory of a planner code over 8 s, as PlanAgent drives it by its default settings.

        It begins at the ego's position with the heading of its path. A trajectory through poses begins with the ego's heading.

        Parameters
        ----------
        centerline
            One of `centerlines()`.
        speed
            Desired speed as a share of the speed limit.
        accelerations
            Maximum acceleration and deceleration, m/s².

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> observation.code(speed=0.0, accelerations=(1.0, 2.0))
        Trajectory(81 states over 8 s)
        """
        try:
            fastest, hardest = accelerations
        except (TypeError, ValueError):
            raise wrong("accelerations", accelerations, "expected two numbers: maximum acceleration and deceleration") from None
        pair = real("accelerations[0]", fastest, 0.0, above=True), real("accelerations[1]", hardest, 0.0, above=True)
        return Trajectory._of(self._native.plan_of_code(text("centerline", centerline), real("speed", speed, 0.0), pair))

    def trajectory(self, plan: Trajectory | ArrayLike, dt: float = 0.1) -> Trajectory:
        """A trajectory from the present state through poses.

        Parameters
        ----------
        plan
            T x 3 numbers: x, y, heading of the rear axle in the map frame. The first pose is `dt` after the present. A
            `Trajectory` is returned as it is.
        dt
            Seconds between two poses.

        Examples
        --------
        >>> import numpy as np, planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> observation.trajectory(np.tile(observation.ego.pose, (40, 1)))
        Trajectory(41 states over 4 s)
        """
        if isinstance(plan, Trajectory):
            return plan
        return Trajectory._of(self._native.trajectory(_arrays.poses(plan).tobytes(), seconds("dt", dt)))

    def score(self, trajectories: ArrayLike) -> TrajectoryScores:
        """Scores trajectories by PDM-Closed's measure, as Reflection does.

        Each is tracked by nuPlan's LQR controller from the present state, while the other agents keep their velocity.

        Parameters
        ----------
        trajectories
            N x T x 3 numbers: x, y, heading of the rear axle in the map frame, 0.1 s apart, the first 0.1 s after the
            present. T lies in 3 to 80; PDM-Closed's is 40.

        Examples
        --------
        >>> import numpy as np, planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> stop = np.tile(observation.ego.pose, (1, 40, 1))
        >>> go = observation.code().poses[None, 1:41]
        >>> scores = observation.score(np.concatenate([stop, go]))
        >>> bool(scores.score[1] > scores.score[0])
        True
        """
        array = _arrays.poses(trajectories, 3)
        packed = _core.score_trajectories(self._native, array.tobytes(), array.shape[1])
        return TrajectoryScores(*_arrays.unpacked(packed, 8).T)


def _observation(data: bytes) -> Observation:
    return Observation._of(_core.Observation.of_bytes(data))


def native_observation(value: object) -> _core.Observation:
    """The native half of an observation."""
    if not isinstance(value, Observation):
        raise ArgumentError(f"expected an Observation, got {type(value).__name__}")
    return value._native
