"""Runs on Ray: whatever is killed, nothing is lost, and the bytes are those of one process."""

import hashlib
import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import planagent
import pytest

ray = pytest.importorskip("ray")
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(1800)]

SCENES = [f"generated/{kind}/{seed}" for kind in ("changing_lane", "stopping_with_lead") for seed in range(40)]
PLANNERS, CHALLENGE = ["pdm-closed", "idm"], "both"
#: What is killed, 20 times in all.
KILLS = ["worker"] * 10 + ["raylet"] * 5 + ["driver"] * 5
#: Simulations that are completed between two kills.
BETWEEN = 4
#: What a driver runs; it prints how far it is.
DRIVER = f"""
import ray, sys, planagent.ray
ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
planagent.ray.simulate({SCENES!r}, {PLANNERS!r}, out=sys.argv[1], workers=2, parts=24, challenge={CHALLENGE!r})
"""


def digests(run):
    """Digests of all files of a run without measured times and the stamp of the start."""
    found = {}
    for path in sorted(path for path in Path(run).rglob("*") if path.is_file()):
        if path.name in (".lock", "timing.json", "runner_report.parquet"):
            continue
        data = path.read_bytes()
        left_out = {"manifest.toml": rb"started", "record.toml": rb"started_s|ended_s|planner_s"}.get(path.name)
        if left_out is not None:
            data = re.sub(rb"(?m)^(" + left_out + rb") = .*\n", b"", data)
        # nuPlan's name of the file of the means ends in the start.
        name = str(path.relative_to(run)).split("_metrics_")[0]
        assert name not in found
        found[name] = hashlib.sha256(data).hexdigest()
    return found


def processes_of(driver):
    """Processes that a driver started, and theirs: pid and command line."""
    shown = subprocess.run(["ps", "-ww", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True).stdout
    rows = [line.split(None, 2) for line in shown.splitlines()]
    found, parents = [], {driver}
    while parents:
        children = [(int(pid), args) for pid, parent, args in rows if int(parent) in parents]
        found, parents = found + children, {pid for pid, _ in children}
    return found


def chosen(kind, driver):
    """The process to kill, if there is one."""
    if kind == "driver":
        return driver.pid
    word = {"worker": "ray::_Worker", "raylet": "/raylet/raylet "}[kind]
    pids = [pid for pid, args in processes_of(driver.pid) if word in args]
    return pids[0] if pids else None


def test_twenty_kills_lose_nothing(tmp_path):
    whole = planagent.simulate(SCENES, PLANNERS, out=tmp_path / "whole", challenge=CHALLENGE)
    out = tmp_path / "spread"
    parts = tmp_path / "spread.parts"
    completed = lambda: len(list(parts.glob("*/simulations/*/record.toml")))  # noqa: E731
    kills = KILLS[:]
    random.Random(0).shuffle(kills)
    killed, lost, drivers = {kind: 0 for kind in KILLS}, [], 0
    driver = None
    try:
        while not (out / "summary.json").is_file():
            if driver is None or driver.poll() is not None:
                assert drivers < len(KILLS) + 3, "the driver ends by itself"
                driver, drivers = subprocess.Popen([sys.executable, "-c", DRIVER, str(out)], start_new_session=True), drivers + 1
                before = completed()
            time.sleep(0.02)
            if not kills or completed() < before + BETWEEN:
                continue
            pid = chosen(kills[-1], driver)
            if pid is None:
                continue
            before = completed()
            os.kill(pid, signal.SIGKILL)
            killed[kills.pop()] += 1
            if pid == driver.pid:
                driver.wait()
            lost.append(before - completed())
        assert driver.wait(120) == 0
    finally:
        for pid, _ in processes_of(driver.pid) if driver is not None else []:
            os.kill(pid, signal.SIGKILL)
    print(f"killed {killed} under {drivers} drivers")
    assert kills == [], f"the run ended {len(kills)} kills early"
    # What was completed stayed.
    assert max(lost) <= 0
    assert not parts.exists()
    ours = digests(out)
    assert len(ours) > 6 * len(SCENES)
    assert ours == digests(whole.folder)
    timeless = lambda results: {k: v for k, v in results.table().to_dict().items() if k != "seconds"}  # noqa: E731
    assert timeless(planagent.resume(out)) == timeless(whole)


class Slow:
    """A planner in Python."""

    def plan(self, observation):
        return observation.code(speed=0.5)


def test_a_lost_node_is_replaced(tmp_path):
    from planagent.ray import simulate
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    node = cluster.add_node(num_cpus=1)
    ray.init(address=cluster.address, log_to_driver=False)
    # Workers cannot import this file.
    ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])
    heard = []

    def lose(progress):
        heard.append(progress)
        if len(heard) == 3:
            cluster.remove_node(node, allow_graceful=False)
        if len(heard) == 6:
            cluster.add_node(num_cpus=1)

    try:
        planners = {"slow": Slow, "idm": "idm"}
        results = simulate(SCENES, planners, out=tmp_path / "spread", workers=2, parts=40, progress=lose)
        again = simulate(SCENES, planners, out=tmp_path / "spread", workers=2)
    finally:
        ray.shutdown()
        cluster.shutdown()
    whole = planagent.simulate(SCENES, planners, out=tmp_path / "whole")
    assert len(heard) > 6 and heard[-1].done == heard[-1].total == 2 * len(SCENES) and heard[-1].failed == 0
    assert digests(results.folder) == digests(whole.folder)
    assert again.table().to_dict() == results.table().to_dict()


def test_other_arguments_are_refused(tmp_path):
    from planagent.ray import PARTS, simulate

    out = tmp_path / "run"
    (tmp_path / f"run{PARTS}").mkdir()
    (tmp_path / f"run{PARTS}" / "parts").write_text("4")
    with pytest.raises(ValueError, match="begun with 4 parts"):
        ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
        simulate(SCENES[:8], "idm", out=out, parts=5)
    try:
        # One part was simulated with another setting before.
        planagent.simulate(
            SCENES[:8], "idm", out=tmp_path / f"run{PARTS}" / "00001", shard="1/4", settings={"seed": 3}
        )
        with pytest.raises(planagent.errors.RunError, match="seed"):
            simulate(SCENES[:8], "idm", out=out)
        out.mkdir()
        (out / "file").write_text("mine")
        with pytest.raises(planagent.errors.RunError, match="not empty"):
            simulate(SCENES[:8], "idm", out=out)
    finally:
        ray.shutdown()
