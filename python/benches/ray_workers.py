"""Efficiency of Ray from one worker to two: the same run with each, without the time until the first batch ends.

$ python python/benches/ray_workers.py 2000
"""

import sys
import tempfile
import time
from pathlib import Path

import planagent.ray
import ray

SCENES = int(sys.argv[1]) if len(sys.argv) > 1 else 2000


def rate(workers, folder):
    """Simulations a second between the end of the first batch and that of the last."""
    heard = []
    names = [f"generated/changing_lane/{seed}" for seed in range(SCENES)]
    planagent.ray.simulate(
        names, "pdm-closed", out=Path(folder) / str(workers), workers=workers, parts=64,
        progress=lambda progress: heard.append((time.monotonic(), progress.done)),
    )
    (begun, first), (ended, last) = heard[0], heard[-1]
    print(f"{workers} workers: {last - first} simulations in {ended - begun:.0f} s")
    return (last - first) / (ended - begun)


def main():
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    with tempfile.TemporaryDirectory() as folder:
        one, two = rate(1, folder), rate(2, folder)
    print(f"efficiency {two / (2 * one):.2f}")


if __name__ == "__main__":
    main()
