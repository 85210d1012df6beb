"""One simulation by nuplan-devkit and tuplan_garage, as their own configuration files describe it.

The devkit's `run_simulation.py` needs PyTorch Lightning and its builders need PyTorch. `simulate` does what
`build_simulations` and `run_runners` do, with the devkit's own classes and without these packages. Nothing of the
devkit is changed.
"""

import copy
import gc
import logging
import os
import time
import traceback
import warnings
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

# The devkit's name of each challenge, by ours.
CHALLENGES = {"nonreactive": "closed_loop_nonreactive_agents", "reactive": "closed_loop_reactive_agents"}
# The devkit's configuration of each planner, by our name.
PLANNERS = {
    "log-replay": "log_future_planner",
    "simple": "simple_planner",
    "idm": "idm_planner",
    "pdm-closed": "pdm_closed_planner",
}
# Ours inside the devkit, where the Python package is installed.
IN_DEVKIT = {
    "plan-agent in the devkit": "plan_agent",
    "pdm-closed in the devkit": "pdm_closed_rust",
    "idm in the devkit": "idm_rust",
}
# A file of nuPlan's maps folder, and the folder of versions in nuPlan's map configuration.
MAP_VERSION = "nuplan-maps-v1.0"
# Statistics columns of nuPlan's metric files end so.
VALUE = "_stat_value"


class Devkit:
    """The devkit on one folder of exported logs and maps."""

    def __init__(self, devkit: Path, exported: Path):
        self._config = devkit / "nuplan/planning/script/config/simulation"
        self._data, self._maps = (str((exported / name).resolve()) for name in ("data", "maps"))
        self._scenarios = None
        self._configurations = {}
        # The devkit reads these when it is imported and when it composes its configuration.
        os.environ["NUPLAN_DATA_ROOT"] = self._data
        os.environ["NUPLAN_MAPS_ROOT"] = self._maps
        os.environ.setdefault("NUPLAN_EXP_ROOT", str(exported.resolve()))
        # Its progress bars would hide ours.
        os.environ["TQDM_DISABLE"] = "1"
        warnings.filterwarnings("ignore")
        logging.disable(logging.WARNING)

    def configuration(self, planner: str, challenge: str, output: Path):
        """The hydra configuration of a simulation, from the yaml files of both projects."""
        known = self._configurations
        if (planner, challenge) not in known:
            composed = self._compose(planner, challenge)
            known[planner, challenge] = (composed, copy.deepcopy(composed.simulation_metric))
        configuration, metrics = known[planner, challenge]
        # The devkit takes parts out of the metrics' configuration when it builds them.
        configuration.simulation_metric = copy.deepcopy(metrics)
        configuration.output_dir = str(output)
        return configuration

    def _compose(self, planner: str, challenge: str):
        from hydra import compose, initialize_config_dir

        metrics = f"simulation_{CHALLENGES[challenge]}"
        places = ["pkg://nuplan.planning.script.config.common", "pkg://nuplan.planning.script.experiments"]
        if find_spec("tuplan_garage") is not None:
            places.insert(0, "pkg://tuplan_garage.planning.script.config.simulation")
        if find_spec("planagent") is not None:
            places.insert(0, "pkg://planagent.nuplan.config")
        overrides = [
            f"+simulation={CHALLENGES[challenge]}",
            f"planner={(PLANNERS | IN_DEVKIT)[planner]}",
            f"simulation_metric=[{metrics},common_metrics]",
            "scenario_filter=all_scenarios",
            "scenario_builder=nuplan",
            f"scenario_builder.data_root={self._data}",
            f"scenario_builder.map_root={self._maps}",
            "worker=sequential",
            "output_dir=unknown",
            f"hydra.searchpath=[{','.join(places)}]",
        ]
        with initialize_config_dir(str(self._config.resolve()), version_base="1.1"):
            return compose("default_simulation", overrides=overrides)

    def scenarios(self) -> dict:
        """Every scenario that the devkit finds, by token."""
        if self._scenarios is None:
            from nuplan.planning.script.builders.scenario_building_builder import build_scenario_builder
            from nuplan.planning.script.builders.scenario_filter_builder import build_scenario_filter
            from nuplan.planning.utils.multithreading.worker_sequential import Sequential

            config = self.configuration("simple", "nonreactive", Path(self._data))
            found = build_scenario_builder(config).get_scenarios(
                build_scenario_filter(config.scenario_filter), Sequential()
            )
            self._scenarios = {scenario.token: scenario for scenario in found}
        return self._scenarios

    def simulate(self, token: str, planner: str, challenge: str) -> dict:
        """Runs a simulation with its metrics and the aggregator; an exception becomes the key `error`."""
        with TemporaryDirectory() as folder:
            # The aggregator finds a challenge by its name in the path.
            output = Path(folder) / CHALLENGES[challenge]
            try:
                return self._simulate(token, planner, challenge, output)
            except Exception as error:
                trace = traceback.format_exc().strip().splitlines()
                return {"error": f"{type(error).__name__}: {error}", "trace": trace[-12:]}
            finally:
                # PDM-Closed turns the collector off at each step.
                gc.enable()
                gc.collect()

    def _simulate(self, token: str, planner: str, challenge: str, output: Path) -> dict:
        from hydra.utils import instantiate
        from nuplan.planning.script.builders.metric_aggregator_builder import build_metrics_aggregators
        from nuplan.planning.script.builders.metric_builder import build_metrics_engines
        from nuplan.planning.simulation.callback.metric_callback import MetricCallback
        from nuplan.planning.simulation.callback.multi_callback import MultiCallback
        from nuplan.planning.simulation.runner.simulations_runner import SimulationRunner
        from nuplan.planning.simulation.simulation import Simulation
        from nuplan.planning.simulation.simulation_setup import SimulationSetup

        scenario = self.scenarios()[token]
        config = self.configuration(planner, challenge, output)
        engines = build_metrics_engines(cfg=config, scenarios=[scenario])
        own = build_planner(config.planner, scenario)
        setup = SimulationSetup(
            time_controller=instantiate(config.simulation_time_controller, scenario=scenario),
            observations=instantiate(config.observation, scenario=scenario),
            ego_controller=instantiate(config.ego_controller, scenario=scenario),
            scenario=scenario,
        )
        callbacks = MultiCallback([MetricCallback(metric_engine=engines[scenario.scenario_type])])
        simulation = Simulation(
            simulation_setup=setup,
            callback=callbacks,
            simulation_history_buffer_duration=config.simulation_history_buffer_duration,
        )
        runner = SimulationRunner(simulation, own)
        wall, cpu = time.perf_counter(), time.process_time()
        report = runner.run()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        instantiate(config.main_callback.metric_file_callback).on_run_simulation_end()
        aggregators = build_metrics_aggregators(config)
        instantiate(
            config.main_callback.metric_aggregator_callback, metric_aggregators=aggregators
        ).on_run_simulation_end()
        result = read_results(output)[token, own.name()]
        steps = [1000 * seconds for seconds in report.planner_report.compute_trajectory_runtimes]
        result |= {"wall_s": wall, "cpu_s": cpu, "step_ms": steps, "ego": ego_of(simulation.history)}
        return result


def build_planner(configuration, scenario):
    """What `build_planners` does for a planner without a model."""
    from hydra.utils import get_class, instantiate

    [planner] = configuration.values()
    if get_class(planner._target_).requires_scenario:
        return instantiate(planner, scenario=scenario)
    return instantiate(planner)


def ego_of(history) -> list:
    """Time, rear axle and speed of the ego at each iteration."""
    states = [sample.ego_state for sample in history.data]
    return [
        [s.time_us, s.rear_axle.x, s.rear_axle.y, s.rear_axle.heading, s.dynamic_car_state.rear_axle_velocity_2d.x]
        for s in states
    ]


def read_results(folder: Path) -> dict:
    """Values, time series and score of each simulation in nuPlan's result tree, by scenario and planner.

    `values` has the score of a metric under `METRIC` and its statistics under `METRIC/STATISTIC`.
    """
    import pandas

    found = {}
    for path in sorted((folder / "metrics").glob("*.parquet")):
        for row in pandas.read_parquet(path).to_dict("records"):
            own = found.setdefault((row["scenario_name"], row["planner_name"]), {"values": {}, "series": {}})
            metric = path.stem
            names = [name.removesuffix(VALUE) for name in row if name.endswith(VALUE)]
            own["values"][metric] = number(row["metric_score"])
            # A file has a column for a statistic that any of its simulations has.
            known = [name for name in names if row[f"{name}_stat_type"] is not None]
            own["values"] |= {f"{metric}/{name}": number(row[f"{name}{VALUE}"]) for name in known}
            if row["time_series_values"] is not None:
                own["series"][metric] = [number(value) for value in row["time_series_values"]]
    for path in (folder / "aggregator_metric").glob("*.parquet"):
        for row in pandas.read_parquet(path).to_dict("records"):
            if (own := found.get((row["scenario"], row["planner_name"]))) is not None:
                own["score"] = number(row["score"])
    return found


def number(value) -> float | None:
    """A value of a table; booleans are 0 and 1, a missing value is None."""
    return None if value is None or value != value else float(value)
