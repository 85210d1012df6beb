"""Planners of the library inside nuplan-devkit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.actor_state.vehicle_parameters import VehicleParameters, get_pacifica_parameters
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks, Observation
from nuplan.planning.simulation.planner.abstract_planner import (
    AbstractPlanner,
    PlannerInitialization,
    PlannerInput,
)
from nuplan.planning.simulation.trajectory.abstract_trajectory import AbstractTrajectory

from .. import _arrays, _core
from .._planners import settings_json
from ..errors import PlannerError

__all__ = ["ArrayTrajectory", "PlanAgentPlanner"]

#: Numbers of nuPlan's agents; the others are static and have no velocity.
AGENTS = 3


class ArrayTrajectory(AbstractTrajectory):
    """A trajectory that makes the devkit's states when they are asked for, and interpolates as `InterpolatedTrajectory` does.

    Parameters
    ----------
    times_us
        Times, microseconds.
    states
        A row of x, y, heading, vx, vy, ax, ay, steering angle for each time; poses of the rear axle in the devkit's frame.
    vehicle
        The ego vehicle.
    """

    def __init__(
        self,
        times_us: NDArray[np.int64],
        states: NDArray[np.float64],
        vehicle: VehicleParameters | None = None,
    ) -> None:
        self._times_us, self._vehicle = times_us, vehicle or get_pacifica_parameters()
        self._states = states.copy()
        self._states[:, 2] = np.unwrap(self._states[:, 2])

    @property
    def start_time(self) -> TimePoint:
        """Time of the first state."""
        return TimePoint(int(self._times_us[0]))

    @property
    def end_time(self) -> TimePoint:
        """Time of the last state."""
        return TimePoint(int(self._times_us[-1]))

    def get_state_at_time(self, time_point: TimePoint) -> EgoState:
        """The state at a time."""
        return self.get_state_at_times([time_point])[0]

    def get_state_at_times(self, time_points: Sequence[TimePoint]) -> list[EgoState]:
        """The states at some times."""
        times = np.array([point.time_us for point in time_points], dtype=np.int64)
        first, last = self._times_us[0], self._times_us[-1]
        assert (times >= first).all() and (times <= last).all(), f"{times} lies outside {first} to {last}"
        after = np.clip(np.searchsorted(self._times_us, times), 1, len(self._times_us) - 1)
        begin, end = self._times_us[after - 1], self._times_us[after]
        share = ((times - begin) / (end - begin))[:, None]
        rows = self._states[after - 1] + (self._states[after] - self._states[after - 1]) * share
        return [self._state(int(time), row) for time, row in zip(times, rows)]

    def get_sampled_trajectory(self) -> list[EgoState]:
        """All states."""
        return [self._state(int(time), row) for time, row in zip(self._times_us, self._states)]

    def _state(self, time_us: int, row: NDArray[np.float64]) -> EgoState:
        x, y, heading, vx, vy, ax, ay, angle = row.tolist()
        return EgoState.build_from_rear_axle(
            rear_axle_pose=StateSE2(x, y, (heading + np.pi) % (2 * np.pi) - np.pi),
            rear_axle_velocity_2d=StateVector2D(vx, vy),
            rear_axle_acceleration_2d=StateVector2D(ax, ay),
            tire_steering_angle=angle,
            time_point=TimePoint(time_us),
            vehicle_parameters=self._vehicle,
        )


def sample(ego: EgoState, observation: Any) -> tuple[int, list[float], list[tuple[str, int, list[float]]]]:
    """The ego and the objects as numbers."""
    car, pose = ego.dynamic_car_state, ego.rear_axle
    velocity, acceleration = car.rear_axle_velocity_2d, car.rear_axle_acceleration_2d
    numbers = [
        pose.x,
        pose.y,
        pose.heading,
        velocity.x,
        velocity.y,
        acceleration.x,
        acceleration.y,
        ego.tire_steering_angle,
        car.tire_steering_rate,
        car.angular_velocity,
        car.angular_acceleration,
    ]
    objects = []
    for tracked in observation.tracked_objects.tracked_objects:
        kind, box = int(tracked.tracked_object_type.value), tracked.box
        center = box.center
        vx, vy = (tracked.velocity.x, tracked.velocity.y) if kind < AGENTS else (0.0, 0.0)
        values = [center.x, center.y, center.heading, box.length, box.width, vx, vy]
        objects.append((tracked.track_token, kind, values))
    return ego.time_us, numbers, objects


class PlanAgentPlanner(AbstractPlanner):
    """A planner of the library for nuplan-devkit, by default the agent of the paper.

    It holds its arguments alone until `initialize`, so it pickles into workers and simulation logs. A model is loaded once in a
    process. The map is read from the folder of `NUPLAN_MAPS_ROOT`, once in a process too.

    Parameters
    ----------
    planner
        One of `planagent.planners()`, without `log-replay`.
    model, seed, settings
        As `planagent.Agent` takes them.
    """

    requires_scenario = False

    def __init__(
        self,
        planner: str = "plan-agent",
        model: str | None = None,
        seed: int | None = None,
        settings: dict[str, Any] | None = None,
    ) -> None:
        self._arguments = (planner, model, seed, settings)
        self._forget()

    def _forget(self) -> None:
        self._native: _core.Planner | None = None
        self._world: _core.NuPlanWorld | None = None
        self._seen = False

    def __getstate__(self) -> dict[str, Any]:
        # What is left can be made again; the devkit pickles planners before a simulation and after it.
        return {"_arguments": self._arguments, "_compute_trajectory_runtimes": self._compute_trajectory_runtimes}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def name(self) -> str:
        """The name in result files."""
        return self._arguments[0].replace("-", "_")

    def observation_type(self) -> type[Observation]:
        """Tracked boxes."""
        return DetectionsTracks  # type: ignore[no-any-return]

    def initialize(self, initialization: PlannerInitialization) -> None:
        """Prepares for a scenario: reads the map, loads the model."""
        self._forget()
        planner, model, seed, settings = self._arguments
        maps = getattr(initialization.map_api, "_maps_db", None)
        if maps is None:
            kind = type(initialization.map_api).__name__
            raise PlannerError(f"the map is a {kind}; a map of nuPlan (NuPlanMap) is needed, which is read from its folder")
        goal = initialization.mission_goal
        self._world = _core.NuPlanWorld(
            str(maps._map_root),
            initialization.map_api.map_name,
            [int(block) for block in initialization.route_roadblock_ids],
            None if goal is None else (goal.x, goal.y, goal.heading),
        )
        self._native = _core.Planner(planner, settings_json(settings, seed=seed, mllm__model=model), None)

    def compute_planner_trajectory(self, current_input: PlannerInput) -> AbstractTrajectory:
        """The trajectory from now on."""
        if self._native is None or self._world is None:
            raise PlannerError("the planner was asked for a trajectory before it was initialized")
        history = current_input.history
        pairs = list(zip(history.ego_states, history.observations))
        new = pairs[-1:] if self._seen else pairs
        self._seen = True
        lights = [
            (int(light.lane_connector_id), light.status.name.lower())
            for light in current_input.traffic_light_data or []
        ]
        samples = [sample(ego, observation) for ego, observation in new]
        observation = self._world.observe(current_input.iteration.index, samples, lights)
        native = self._native.plan(observation)
        states = _arrays.unpacked(native.states(), 8).copy()
        states[:, :2] += self._world.origin
        vehicle = history.ego_states[-1].car_footprint.vehicle_parameters
        return ArrayTrajectory(np.array(native.times_us(), dtype=np.int64), states, vehicle)
