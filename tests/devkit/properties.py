#!/usr/bin/env python3
"""Ask nuplan-devkit everything that its users ask of logs and maps, on an exported folder, and report every exception.

    python tests/devkit/properties.py --devkit CLONE --exported FOLDER [--limit N]

Asked are: each filter of NuPlanScenarioBuilder; ego, agents, lights, goals, route and tags of each scenario; each layer
of its map; and every property and method of every map object within 200 m of the ego. Prints a line for each different
exception with its first place, and the number of questions. The exit code is 1 if there was one.
"""

import argparse
import inspect
import json
import sqlite3
import sys
from collections import Counter
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from devkit_side import Devkit

# Map objects are asked within this distance of the ego, m.
RADIUS = 200.0
# Iterations between two questions about a scenario.
STRIDE = 25
# Seconds of past and future that are asked.
HORIZON = 2.0


class Questions:
    """Counts questions, and exceptions by what was asked."""

    def __init__(self):
        self.asked = Counter()
        self.wrong = {}
        # What the devkit's own classes leave abstract.
        self.abstract = Counter()

    @contextmanager
    def about(self, subject: str, place: str):
        self.asked[subject] += 1
        try:
            yield
        except NotImplementedError:
            self.abstract[subject] += 1
        except Exception as error:
            said = f"{subject}: {type(error).__name__}: {str(error)[:160]}"
            count, first = self.wrong.get(said, (0, place))
            self.wrong[said] = (count + 1, first)

    def expect(self, subject: str, place: str, true: bool, otherwise: str) -> None:
        with self.about(subject, place):
            if not true:
                raise AssertionError(otherwise)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devkit", type=Path, required=True, help="a clone of nuplan-devkit")
    parser.add_argument("--exported", type=Path, required=True, help="folder that `scenarios export` wrote")
    parser.add_argument("--limit", type=int, help="ask about so many scenarios")
    return parser.parse_args()


def main() -> int:
    options = arguments()
    sys.path.insert(0, str(options.devkit.resolve()))
    devkit = Devkit(options.devkit, options.exported)
    questions = Questions()
    scenarios = list(devkit.scenarios().values())
    check_logs(questions, options.exported, scenarios)
    check_filters(questions, devkit, scenarios)
    maps = set()
    for number, scenario in enumerate(scenarios[: options.limit], 1):
        print(f"{number}/{len(scenarios)} {scenario.log_name}", file=sys.stderr, flush=True)
        check_scenario(questions, scenario)
        check_layers(questions, scenario)
        if scenario.map_api.map_name not in maps:
            maps.add(scenario.map_api.map_name)
            check_objects(questions, scenario)
    return report(questions, len(scenarios[: options.limit]), len(maps))


def report(questions: Questions, scenarios: int, maps: int) -> int:
    for said, (count, place) in sorted(questions.wrong.items(), key=lambda item: -item[1][0]):
        print(f"{count} x {said}  (first: {place})")
    failed = sum(count for count, _ in questions.wrong.values())
    kinds = Counter({subject.split(".")[0]: 0 for subject in questions.asked})
    for subject, count in questions.asked.items():
        kinds[subject.split(".")[0]] += count
    print(", ".join(f"{count} of {kind}" for kind, count in sorted(kinds.items())))
    print(f"not implemented in the devkit: {', '.join(sorted(questions.abstract)) or 'nothing'}")
    abstract = sum(questions.abstract.values())
    print(f"{scenarios} scenarios, {maps} maps, {sum(kinds.values())} questions, {abstract} of them not implemented")
    print(f"{failed} exceptions")
    return 1 if failed else 0


def check_logs(questions: Questions, exported: Path, scenarios: list) -> None:
    """A log is a scenario with the type of its tag."""
    logs = sorted((exported / "data").glob("*.db"))
    said = f"{len(scenarios)} scenarios in {len(logs)} logs"
    questions.expect("builder.scenarios", str(exported), len(scenarios) == len(logs), said)
    found = {scenario.log_name: scenario for scenario in scenarios}
    for log in logs:
        with questions.about("builder.tag", log.stem), sqlite3.connect(log) as connection:
            tags = connection.execute("SELECT hex(lidar_pc_token), type FROM scenario_tag").fetchall()
            own = found[log.stem]
            assert (own.token.upper(), own.scenario_type) in tags, (own.token, own.scenario_type, tags)


def check_filters(questions: Questions, devkit: Devkit, scenarios: list) -> None:
    """Each field of ScenarioFilter alone, with the number of scenarios that has to remain where it is known."""
    first, count = scenarios[0], len(scenarios)
    types = {scenario.scenario_type for scenario in scenarios}
    of_type = sum(scenario.scenario_type == first.scenario_type for scenario in scenarios)
    on_map = sum(scenario.map_api.map_name == first.map_api.map_name for scenario in scenarios)
    with TemporaryDirectory() as folder:
        tokens = Path(folder) / "tokens.json"
        tokens.write_text(json.dumps(first._lidarpc_tokens))
        filters = [
            ({"scenario_tokens": [first.token]}, 1),
            ({"scenario_types": [first.scenario_type]}, of_type),
            ({"log_names": [first.log_name]}, 1),
            ({"map_names": [first.map_api.map_name]}, on_map),
            ({"num_scenarios_per_type": 1}, len(types)),
            ({"limit_total_scenarios": 2}, min(2, count)),
            ({"limit_total_scenarios": 0.5}, None),
            ({"timestamp_threshold_s": 15.0}, None),
            ({"ego_displacement_minimum_m": 1.0}, None),
            ({"ego_start_speed_threshold": 0.5, "speed_noise_tolerance": 0.1}, None),
            ({"ego_stop_speed_threshold": 0.5, "speed_noise_tolerance": 0.1}, None),
            ({"expand_scenarios": True, "log_names": [first.log_name]}, None),
            ({"remove_invalid_goals": True}, count),
            ({"shuffle": True}, count),
            ({"ego_route_radius": 50.0}, None),
            ({"token_set_path": str(tokens), "fraction_in_token_set_threshold": 0.99}, 1),
        ]
        for fields, expected in filters:
            name = f"filter.{next(iter(fields))}"
            with questions.about(name, str(fields)):
                found = len(filtered(devkit, fields))
                assert expected is None or found == expected, f"{found} scenarios instead of {expected}"


def filtered(devkit: Devkit, fields: dict) -> list:
    from nuplan.planning.scenario_builder.scenario_filter import ScenarioFilter
    from nuplan.planning.script.builders.scenario_building_builder import build_scenario_builder
    from nuplan.planning.utils.multithreading.worker_sequential import Sequential

    every = [name for name in inspect.signature(ScenarioFilter).parameters]
    flags = ("expand_scenarios", "remove_invalid_goals", "shuffle")
    nothing = {name: False if name in flags else None for name in every}
    builder = build_scenario_builder(devkit.configuration("simple", "nonreactive", Path("unused")))
    return builder.get_scenarios(ScenarioFilter(**(nothing | fields)), Sequential())


def check_scenario(questions: Questions, scenario) -> None:
    """What a planner, a metric or a feature builder asks of a scenario."""
    name = scenario.log_name
    for member in properties(type(scenario)):
        if member not in ("initial_sensors", "_lidarpc_tokens"):
            with questions.about(f"scenario.{member}", name):
                getattr(scenario, member)
    for method in ("get_route_roadblock_ids", "get_scenario_tokens", "get_number_of_iterations"):
        with questions.about(f"scenario.{method}", name):
            assert getattr(scenario, method)(), "nothing"
    for method in ("get_mission_goal", "get_expert_goal_state", "get_lidar_to_ego_transform"):
        with questions.about(f"scenario.{method}", name):
            assert getattr(scenario, method)() is not None, "None"
    with questions.about("scenario.get_expert_ego_trajectory", name):
        assert len(list(scenario.get_expert_ego_trajectory())) >= scenario.get_number_of_iterations()
    for iteration in range(0, scenario.get_number_of_iterations(), STRIDE):
        place = f"{name} at {iteration}"
        for method in ("get_time_point", "get_ego_state_at_iteration", "get_tracked_objects_at_iteration"):
            with questions.about(f"scenario.{method}", place):
                getattr(scenario, method)(iteration)
        with questions.about("scenario.get_traffic_light_status_at_iteration", place):
            list(scenario.get_traffic_light_status_at_iteration(iteration))
        with questions.about("scenario.get_tracked_objects_within_time_window_at_iteration", place):
            scenario.get_tracked_objects_within_time_window_at_iteration(iteration, HORIZON, HORIZON)
        for method in (
            "get_past_timestamps",
            "get_future_timestamps",
            "get_ego_past_trajectory",
            "get_ego_future_trajectory",
            "get_past_tracked_objects",
            "get_future_tracked_objects",
            "get_past_traffic_light_status_history",
            "get_future_traffic_light_status_history",
        ):
            with questions.about(f"scenario.{method}", place):
                list(getattr(scenario, method)(iteration, HORIZON))


def check_layers(questions: Questions, scenario) -> None:
    """The route, and the questions by layer at the ego's start."""
    from nuplan.common.maps.maps_datatypes import SemanticMapLayer

    world, name = scenario.map_api, f"{scenario.log_name}"
    point = scenario.initial_ego_state.center.point
    for block in scenario.get_route_roadblock_ids():
        with questions.about("map.route", f"{name} roadblock {block}"):
            layers = (SemanticMapLayer.ROADBLOCK, SemanticMapLayer.ROADBLOCK_CONNECTOR)
            assert any(world.get_map_object(block, layer) for layer in layers), "not on the map"
    for layer in world.get_available_map_objects():
        place = f"{name} {layer.name}"
        with questions.about("map.get_all_map_objects", place):
            world.get_all_map_objects(point, layer)
        with questions.about("map.get_proximal_map_objects", place):
            world.get_proximal_map_objects(point, RADIUS, [layer])
    for layer in world._vector_layer_mapping:
        place = f"{name} {layer.name}"
        if not len(world._get_vector_map_layer(layer)):
            # pandas and geopandas refuse these questions on an empty layer, whatever wrote it.
            continue
        with questions.about("map.is_in_layer", place):
            world.is_in_layer(point, layer)
        with questions.about("map.get_distance_to_nearest_map_object", place):
            world.get_distance_to_nearest_map_object(point, layer)
        with questions.about("map.get_distances_matrix_to_nearest_map_object", place):
            world.get_distances_matrix_to_nearest_map_object([point, point], layer)


def check_objects(questions: Questions, scenario) -> None:
    """Every property and method of the map's objects near the ego."""
    world, point = scenario.map_api, scenario.initial_ego_state.center.point
    for layer in world.get_available_map_objects():
        found = []
        with questions.about("map.get_proximal_map_objects", f"{scenario.log_name} {layer.name}"):
            found = world.get_proximal_map_objects(point, RADIUS, [layer])[layer]
        for thing in found:
            check_object(questions, thing, point, f"{scenario.log_name} {layer.name} {thing.id}")


def check_object(questions: Questions, thing, point, place: str) -> None:
    kind = type(thing).__name__
    answers = {}
    for member in properties(type(thing)):
        with questions.about(f"{kind}.{member}", place):
            answers[member] = getattr(thing, member)
    if "polygon" in answers:
        polygon = answers["polygon"]
        questions.expect(f"{kind}.polygon", place, polygon.is_valid, "the polygon crosses itself")
        with questions.about(f"{kind}.contains_point", place):
            thing.contains_point(point)
    for method in ("get_roadblock_id", "has_traffic_lights"):
        if hasattr(thing, method):
            with questions.about(f"{kind}.{method}", place):
                getattr(thing, method)()
    if hasattr(thing, "get_width_left_right"):
        with questions.about(f"{kind}.get_width_left_right", place):
            thing.get_width_left_right(answers["baseline_path"].discrete_path[0].point)
        with questions.about(f"{kind}.oriented_distance", place):
            thing.oriented_distance(point)
        for other in answers.get("adjacent_edges", ()):
            if other is not None:
                for method in ("is_same_roadblock", "is_adjacent_to", "is_left_of", "is_right_of"):
                    with questions.about(f"{kind}.{method}", place):
                        getattr(thing, method)(other)
    for line in ("baseline_path", "left_boundary", "right_boundary"):
        if line in answers:
            check_line(questions, answers[line], point, f"{place} {line}")


def check_line(questions: Questions, line, point, place: str) -> None:
    kind = type(line).__name__
    for member in properties(type(line)):
        with questions.about(f"{kind}.{member}", place):
            getattr(line, member)
    for method in (
        "get_nearest_arc_length_from_position",
        "get_nearest_pose_from_position",
        "get_nearest_curvature_from_position",
    ):
        with questions.about(f"{kind}.{method}", place):
            getattr(line, method)(point)
    for share in (0.0, 0.5, 1.0):
        with questions.about(f"{kind}.get_curvature_at_arc_length", place):
            line.get_curvature_at_arc_length(share * line.length)


def properties(kind: type) -> list[str]:
    """Names of the properties of a class, its bases included."""
    from functools import cached_property

    every = inspect.getmembers_static(kind, lambda member: isinstance(member, (property, cached_property)))
    return [name for name, _ in every if not name.startswith("_") or name == "_lidarpc_tokens"]


if __name__ == "__main__":
    sys.exit(main())
