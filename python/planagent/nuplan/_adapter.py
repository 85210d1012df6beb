"""Planners of nuplan-devkit in simulations of the library."""

from __future__ import annotations

import copy
import inspect
import os
import re
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from nuplan.common.actor_state.agent import Agent
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.oriented_box import OrientedBox
from nuplan.common.actor_state.scene_object import SceneObjectMetadata
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.actor_state.static_object import StaticObject
from nuplan.common.actor_state.tracked_objects import TrackedObjects
from nuplan.common.actor_state.tracked_objects_types import TrackedObjectType
from nuplan.common.actor_state.vehicle_parameters import get_pacifica_parameters
from nuplan.common.maps.maps_datatypes import TrafficLightStatusData, TrafficLightStatusType
from nuplan.common.maps.nuplan_map.map_factory import get_maps_api
from nuplan.planning.simulation.history.simulation_history_buffer import SimulationHistoryBuffer
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
from nuplan.planning.simulation.planner.abstract_planner import PlannerInitialization, PlannerInput
from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import SimulationIteration

from .. import _arrays, _core
from .._observation import EgoState as Ego
from .._observation import Trajectory
from .._planners import Bound
from ..errors import ArgumentError
from ._planner import AGENTS

__all__ = ["adapted"]

#: Name of a map of nuPlan, as the native half writes it.
MAP_NAME = re.compile(r"(?P<location>\S+) \S+, EPSG:\d+, origin \((?P<x>\S+), (?P<y>\S+)\)")
#: nuPlan's version of its maps, the name of their index.
MAP_VERSION = "nuplan-maps-v1.0"
#: Height of a box, meters; the log's is not kept, and no planner of the devkit asks for it.
HEIGHT = 1.8
#: Time between two samples, seconds.
SAMPLE_INTERVAL_S = 0.1


def adapted(planner: Any) -> Callable[[], Bound]:
    """What makes an adapter of a planner of the devkit for one simulation.

    Parameters
    ----------
    planner
        An `AbstractPlanner`, which is copied for each simulation, or a class of one.
    """
    if inspect.isclass(planner):
        return lambda: _Adapter(planner())
    return lambda: _Adapter(copy.deepcopy(planner))


class _Adapter(Bound):
    """A planner of the devkit in one simulation."""

    def __init__(self, planner: Any) -> None:
        self._planner, self.function = planner, planner.compute_trajectory
        self.reset()

    def reset(self) -> None:
        self._origin: NDArray[np.float64] | None = None
        self._egos: deque[EgoState] = deque(maxlen=_core.Observation.MAX_HISTORY)
        self._objects: deque[DetectionsTracks] = deque(maxlen=_core.Observation.MAX_HISTORY)

    def _begin(self, native: _core.Observation) -> NDArray[np.float64]:
        """Initializes the planner with its map; gives the origin of the map."""
        found = MAP_NAME.fullmatch(native.map_name())
        root = os.environ.get("NUPLAN_MAPS_ROOT")
        if found is None or not root:
            raise ArgumentError(
                "a planner of nuplan-devkit needs a scenario on one of nuPlan's maps, and NUPLAN_MAPS_ROOT. Scenario.export_nuplan "
                "writes any scenario with such a map"
            )
        goal = native.goal()
        origin = np.array([float(found["x"]), float(found["y"])])
        maps = get_maps_api(root, MAP_VERSION, found["location"])
        mission_goal = None if goal is None else StateSE2(goal[0] + origin[0], goal[1] + origin[1], goal[2])
        route = [str(block) for block in native.route()]
        self._planner.initialize(PlannerInitialization(route, mission_goal, maps))
        return origin

    def plan(self, native: _core.Observation) -> _core.Trajectory:
        samples = native.history()
        if self._origin is None:
            self._origin = self._begin(native)
        else:
            samples = samples[-1:]
        for numbers, data in samples:
            ego = Ego._of(numbers)
            self._egos.append(_ego_state(ego, self._origin))
            self._objects.append(_detections(ego.time_us, _arrays.objects(data), self._origin))
        now = self._egos[-1].time_point
        lights = [
            TrafficLightStatusData(TrafficLightStatusType[color.upper()], connector, now.time_us)
            for connector, color in native.source_lights()
        ]
        history = SimulationHistoryBuffer(self._egos, self._objects, SAMPLE_INTERVAL_S)
        planned = self._planner.compute_trajectory(
            PlannerInput(SimulationIteration(now, native.iteration), history, lights)
        )
        states = planned.get_sampled_trajectory()
        poses = np.array([[s.rear_axle.x, s.rear_axle.y, s.rear_axle.heading] for s in states])
        poses[:, :2] -= self._origin
        return Trajectory(poses, [s.time_us for s in states])._native


def _ego_state(ego: Ego, origin: NDArray[np.float64]) -> EgoState:
    return EgoState.build_from_rear_axle(
        rear_axle_pose=StateSE2(ego.x + origin[0], ego.y + origin[1], ego.heading),
        rear_axle_velocity_2d=StateVector2D(ego.vx, ego.vy),
        rear_axle_acceleration_2d=StateVector2D(ego.ax, ego.ay),
        tire_steering_angle=ego.steering_angle,
        time_point=TimePoint(ego.time_us),
        vehicle_parameters=get_pacifica_parameters(),
        angular_vel=ego.angular_velocity,
        angular_accel=ego.angular_acceleration,
        tire_steering_rate=ego.steering_rate,
    )


def _detections(time_us: int, objects: NDArray[np.void], origin: NDArray[np.float64]) -> DetectionsTracks:
    tracked = []
    for record in objects:
        number, kind = int(record["token"]), int(record["kind"])
        center = StateSE2(record["x"] + origin[0], record["y"] + origin[1], float(record["heading"]))
        box = OrientedBox(center, float(record["length"]), float(record["width"]), HEIGHT)
        metadata = SceneObjectMetadata(time_us, f"{number:016x}", number, f"{number:016x}")
        name = TrackedObjectType(kind)
        if kind < AGENTS:
            velocity = StateVector2D(float(record["vx"]), float(record["vy"]))
            tracked.append(Agent(name, box, velocity, metadata))
        else:
            tracked.append(StaticObject(name, box, metadata))
    return DetectionsTracks(TrackedObjects(tracked))
