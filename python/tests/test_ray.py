"""Runs on Ray: whatever is killed, the bytes are those of one process."""

import hashlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import planagent
import pytest

ray = pytest.importorskip("ray")
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.timeout(600)]

SCENES = [f"generated/{kind}/{seed}" for kind in ("changing_lane", "stopping_with_lead") for seed in range(12)]
#: Measured times stand in these.
TIMED = ("timing.json", "runner_report.parquet", "manifest.toml", "config.toml")


def digests(run):
    """Digests of the files of a run that hold no measured time."""
    files = [path for path in Path(run).rglob("*") if path.is_file() and not path.name.startswith(".")]
    return {
        str(path.relative_to(run)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if path.name not in TIMED and path.suffix in {".gz", ".parquet", ".jsonl"} and "runner_report" not in str(path)
    }


def program(out):
    return textwrap.dedent(
        f"""
        import ray, planagent.ray
        ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
        planagent.ray.simulate({SCENES!r}, ["pdm-closed", "idm"], out={str(out)!r}, workers=2, parts=6, challenge="both")
        """
    )


def pids_of_workers(driver):
    shown = subprocess.run(["ps", "-eo", "pid,ppid,args"], capture_output=True, text=True, check=True).stdout
    return [int(line.split()[0]) for line in shown.splitlines() if "ray::" in line and "part" in line]


def test_killed_workers_and_drivers_lose_nothing(tmp_path):
    whole = planagent.simulate(SCENES, ["pdm-closed", "idm"], out=tmp_path / "whole", challenge="both")
    out = tmp_path / "spread"
    for kill in ("worker", "driver", "worker", None):
        driver = subprocess.Popen([sys.executable, "-c", program(out)], start_new_session=True)
        if kill is not None:
            parts = out.with_name("spread.parts")
            begun = time.monotonic()
            while len(list(parts.glob("*/simulations/*"))) < 4 and driver.poll() is None and time.monotonic() - begun < 120:
                time.sleep(0.05)
            if kill == "worker":
                for pid in pids_of_workers(driver)[:1]:
                    os.kill(pid, signal.SIGKILL)
            else:
                os.killpg(driver.pid, signal.SIGKILL)
        driver.wait(300)
        if (out / "summary.json").is_file():
            break
    assert (out / "summary.json").is_file()
    assert digests(out) == digests(whole.folder) and digests(out)
    columns = planagent.resume(out).table().to_dict()
    assert columns["score"] == whole.table().to_dict()["score"]
