"""Writes the simulation logs of a run, which nuBoard's scenario tab shows.

Usage: simulation_logs.py RUN EXPORTED

EXPORTED is the folder that `planagent scenarios export` wrote, and RUN a run on its logs. A simulation log is a pickle of the
devkit's objects, so this needs a Python that imports nuplan-devkit. It names EXPORTED by its absolute path: nuBoard reads
map, route, lights and recorded ego there.

The states are those of `replay.json.gz`, which is rounded: positions to 1 cm, headings to 1 mrad, the ego's rates to 0.01 and the
agents' velocities to 0.1 of SI units. Objects more than 80 m from the ego's path, steering angles and lateral rates of the
ego are not in it. A plan has a point every 0.5 s; its headings and speeds follow from the points. The logs are for viewing: use
the run's own metric files, not metrics of these logs.
"""

import gzip
import json
import math
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import nuplan
import yaml
from nuplan.common.actor_state.agent import Agent
from nuplan.common.actor_state.ego_state import EgoState
from nuplan.common.actor_state.oriented_box import OrientedBox
from nuplan.common.actor_state.scene_object import SceneObjectMetadata
from nuplan.common.actor_state.state_representation import StateSE2, StateVector2D, TimePoint
from nuplan.common.actor_state.static_object import StaticObject
from nuplan.common.actor_state.tracked_objects import TrackedObjects
from nuplan.common.actor_state.tracked_objects_types import AGENT_TYPES, TrackedObjectType
from nuplan.common.actor_state.vehicle_parameters import get_pacifica_parameters
from nuplan.common.geometry.compute import principal_value
from nuplan.planning.scenario_builder.nuplan_db.nuplan_scenario_builder import NuPlanScenarioBuilder
from nuplan.planning.scenario_builder.nuplan_db.nuplan_scenario_utils import ScenarioMapping
from nuplan.planning.scenario_builder.scenario_filter import ScenarioFilter
from nuplan.planning.simulation.history.simulation_history import SimulationHistory, SimulationHistorySample
from nuplan.planning.simulation.observation.observation_type import DetectionsTracks
from nuplan.planning.simulation.simulation_log import SimulationLog
from nuplan.planning.simulation.simulation_time_controller.simulation_iteration import SimulationIteration
from nuplan.planning.simulation.trajectory.interpolated_trajectory import InterpolatedTrajectory
from nuplan.planning.utils.multithreading.worker_sequential import Sequential

try:
    import tomllib
except ModuleNotFoundError:  # before Python 3.11
    import tomli as tomllib

# The format of replay.json.gz (src/runs/report/replay/mod.rs), and its units.
FORMAT = 2
LENGTH, ANGLE, EGO_RATE, AGENT_VELOCITY = 0.01, 0.001, 0.01, 0.1
# Time between the points of a plan, microseconds.
PLAN_STEP_US = 500_000
# The program subtracts a grid point from nuPlan's coordinates (src/scenario/nuplan/layers.rs), meters.
ORIGIN_GRID = 1000.0
# Largest distance between a recorded position and its copy in the replay: half of a unit along x and y, meters.
ROUNDING = 0.51 * LENGTH * math.sqrt(2.0)
# A step of a plan shorter than this has no heading of its own, meters.
STANDSTILL = 0.1


def numbers(deltas, unit):
    """A sequence that is stored as its first number and differences."""
    total, found = 0, []
    for delta in deltas:
        total += delta
        found.append(total * unit)
    return found


class Replay:
    """The replay of a simulation in the coordinates of the log."""

    def __init__(self, folder, scenario):
        with gzip.open(folder / "replay.json.gz", "rt", encoding="utf-8") as file:
            self._data = json.load(file)
        if self._data["format"] != FORMAT:
            raise SystemExit(f"{folder}: the replay has format {self._data['format']}, this script reads {FORMAT}")
        self._scenario = scenario
        self._vehicle = get_pacifica_parameters()
        self.times = [TimePoint(scenario.get_time_point(i).time_us) for i in range(len(self._data["times_ms"]))]
        self._origin = self._find_origin(folder)

    def _find_origin(self, folder):
        """The grid point, and proof that the replay is of this log: the recorded ego is the same."""
        recorded = [state.rear_axle for state in self._scenario.get_expert_ego_trajectory()]
        local = self._points(self._data["expert"], (0.0, 0.0))
        origin = tuple(
            round((ours - theirs) / ORIGIN_GRID) * ORIGIN_GRID
            for ours, theirs in zip((recorded[0].x, recorded[0].y), local[0])
        )
        apart = max(
            math.hypot(pose.x - x - origin[0], pose.y - y - origin[1]) for pose, (x, y) in zip(recorded, local)
        )
        if apart > ROUNDING:
            raise SystemExit(f"{folder}: the recorded ego is {apart:.3f} m from that of the log; is it another log?")
        elapsed = [time.time_us - self.times[0].time_us for time in self.times]
        if any(abs(us - ms * 1000) > 1000 for us, ms in zip(elapsed, numbers(self._data["times_ms"], 1))):
            raise SystemExit(f"{folder}: the times of the simulation are not those of the log")
        return origin

    @staticmethod
    def _points(points, origin):
        xs, ys = (numbers(points[axis], LENGTH) for axis in "xy")
        return [(x + origin[0], y + origin[1]) for x, y in zip(xs, ys)]

    def _poses(self, track):
        headings = numbers(track["heading"], ANGLE)
        return [
            StateSE2(x, y, principal_value(heading))
            for (x, y), heading in zip(self._points(track, self._origin), headings)
        ]

    def _ego(self, pose, speed, acceleration, yaw_rate, time):
        return EgoState.build_from_rear_axle(
            rear_axle_pose=pose,
            rear_axle_velocity_2d=StateVector2D(speed, 0.0),
            rear_axle_acceleration_2d=StateVector2D(acceleration, 0.0),
            tire_steering_angle=0.0,
            time_point=time,
            vehicle_parameters=self._vehicle,
            angular_vel=yaw_rate,
        )

    def egos(self):
        """The ego's states."""
        ego = self._data["ego"]
        rates = (numbers(ego[name], EGO_RATE) for name in ("speed", "acceleration", "yaw_rate"))
        return [self._ego(*state) for state in zip(self._poses(ego), *rates, self.times)]

    def plan(self, iteration, ego):
        """The active plan of an iteration."""
        points = self._points(self._data["plans"][iteration], self._origin)
        if len(points) < 2:
            # The end of the log: less than half a second is left. The devkit's trajectory has at least two states.
            points = [(ego.rear_axle.x, ego.rear_axle.y)] * 2
        states, heading = [], ego.rear_axle.heading
        for k, (x, y) in enumerate(points):
            before, after = points[max(k - 1, 0)], points[min(k + 1, len(points) - 1)]
            step = math.hypot(after[0] - before[0], after[1] - before[1])
            if k > 0 and step > STANDSTILL:
                heading = math.atan2(after[1] - before[1], after[0] - before[0])
            intervals = min(k + 1, len(points) - 1) - max(k - 1, 0)
            speed = step / (intervals * PLAN_STEP_US * 1e-6)
            time = TimePoint(ego.time_us + k * PLAN_STEP_US)
            states.append(self._ego(StateSE2(x, y, heading), speed, 0.0, 0.0, time))
        return InterpolatedTrajectory(states)

    def objects(self):
        """The tracked objects of each iteration."""
        found = [[] for _ in self.times]
        for track in self._data["agents"]:
            kind = TrackedObjectType[track["kind"].upper()]
            length, width = track["length"] * LENGTH, track["width"] * LENGTH
            velocities = zip(numbers(track["vx"], AGENT_VELOCITY), numbers(track["vy"], AGENT_VELOCITY))
            for i, (pose, velocity) in enumerate(zip(self._poses(track), velocities), start=track["from"]):
                token = str(track["token"])
                metadata = SceneObjectMetadata(
                    timestamp_us=self.times[i].time_us,
                    token=f"{token}-{i}",
                    track_id=track["token"],
                    track_token=token,
                    category_name=track["kind"],
                )
                box = OrientedBox(pose, length, width, self._vehicle.height)
                if kind in AGENT_TYPES:
                    found[i].append(Agent(kind, box, StateVector2D(*velocity), metadata))
                else:
                    found[i].append(StaticObject(kind, box, metadata))
        return [DetectionsTracks(TrackedObjects(objects)) for objects in found]

    def history(self):
        """The devkit's history of the simulation. The lights are the log's, in every challenge."""
        samples = [
            SimulationHistorySample(
                iteration=SimulationIteration(self.times[i], i),
                ego_state=ego,
                trajectory=self.plan(i, ego),
                observation=objects,
                traffic_light_status=list(self._scenario.get_traffic_light_status_at_iteration(i)),
            )
            for i, (ego, objects) in enumerate(zip(self.egos(), self.objects()))
        ]
        return SimulationHistory(self._scenario.map_api, self._scenario.get_mission_goal(), samples)


def scenarios_of(exported):
    """The scenarios of the exported logs, with nuPlan's windows, by log and token."""
    configuration = Path(nuplan.__file__).parent / "planning/script/config/common/scenario_builder/scenario_mapping"
    mapping = yaml.safe_load((configuration / "nuplan_scenario_mapping.yaml").read_text())
    builder = NuPlanScenarioBuilder(
        data_root=str(exported / "data"),
        map_root=str(exported / "maps"),
        sensor_root=str(exported / "data"),
        db_files=None,
        map_version="nuplan-maps-v1.0",
        verbose=False,
        scenario_mapping=ScenarioMapping(mapping["scenario_map"], mapping["subsample_ratio_override"]),
    )
    everything = ScenarioFilter(None, None, None, None, None, None, None, None, False, False, False)
    found = builder.get_scenarios(everything, Sequential())
    return {(scenario.log_name, scenario.token): scenario for scenario in found}


def write_log(run, folder, record, scenario):
    """Writes the log of one simulation where the devkit's SimulationLogCallback would."""
    place = run / record["challenge"] / "simulation_log" / record["planner"]
    place = place / scenario.scenario_type / scenario.log_name / scenario.scenario_name
    # nuBoard and the devkit's metric runner ask a planner for its name only.
    planner = SimpleNamespace(name=partial(str, record["planner"]))
    path = place / f"{scenario.scenario_name}.msgpack.xz"
    SimulationLog(path, scenario, planner, Replay(folder, scenario).history()).save_to_file()


def main():
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    run, exported = (Path(argument).resolve() for argument in sys.argv[1:])
    scenarios = scenarios_of(exported)
    written = skipped = 0
    for folder in sorted((run / "simulations").glob("[0-9]*")):
        record = tomllib.loads((folder / "record.toml").read_text(encoding="utf-8"))
        if "error" in record:
            skipped += 1
            continue
        scenario = scenarios.get((record["log_name"], record["scenario"]))
        if scenario is None:
            raise SystemExit(f"{folder}: {exported / 'data'} has no scenario {record['scenario']} in {record['log_name']}")
        write_log(run, folder, record, scenario)
        written += 1
    print(f"{written} simulation logs written, {skipped} failed simulations skipped")


if __name__ == "__main__":
    main()
