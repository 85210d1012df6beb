#!/usr/bin/env python3
"""Write values of the devkit to tests/fixtures/devkit/values.json, which `tests/nuplan/devkit.rs` compares with ours.

    python tests/devkit/make_values.py --devkit CLONE --tuplan CLONE --out FOLDER

FOLDER is that of `compare.py`, which has run the devkit on the scenarios. The file has numbers only. They are of one
scenario of each generated type, with each planner in one of the two challenges in turn.
"""

import argparse
import gzip
import json
import math
import subprocess
from importlib.metadata import version
from pathlib import Path

import our_side
from devkit_side import CHALLENGES, PLANNERS

SEED = 3
COUNT = 64
PACKAGES = ("numpy", "scipy", "shapely", "geopandas", "pandas", "pyarrow", "hydra-core", "SQLAlchemy")
FILE = Path(__file__).parent.parent / "fixtures/devkit/values.json"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--devkit", required=True, help="commit of nuplan-devkit, or a clone of it")
    parser.add_argument("--tuplan", required=True, help="commit of tuplan_garage, or a clone of it")
    parser.add_argument("--out", type=Path, required=True, help="folder of compare.py")
    options = parser.parse_args()
    every = our_side.exported_scenarios(options.out / "exported")
    scenarios = [one for one in every if one.source.startswith("generated/") and one.name.endswith(f"/{SEED}")]
    # Both challenges in turn; where the devkit fails, a simulation of the other challenge takes the place.
    wanted = [
        (scenario, planner, [*CHALLENGES][(place + number + turn) % len(CHALLENGES)])
        for turn in range(len(CHALLENGES))
        for place, scenario in enumerate(scenarios)
        for number, planner in enumerate(PLANNERS)
    ]
    simulations = []
    for scenario, planner, challenge in wanted:
        path = options.out / "devkit" / f"{scenario.digest}-{planner}-{challenge}.json.gz"
        if len(simulations) < COUNT and path.is_file():
            result = json.loads(gzip.decompress(path.read_bytes()))
            if "error" not in result:
                simulations.append((scenario.name, planner, challenge, result))
    columns = sorted({name for *_, result in simulations for name in result["values"]})
    rows = [
        {
            "scenario": scenario,
            "planner": planner,
            "challenge": challenge,
            "score": result["score"],
            "values": [written(result["values"].get(name)) for name in columns],
        }
        for scenario, planner, challenge, result in simulations
    ]
    head = {
        "nuplan-devkit": commit(options.devkit),
        "tuplan_garage": commit(options.tuplan),
        "packages": {name: version(name) for name in PACKAGES},
        "columns": columns,
    }
    lines = [json.dumps(row, separators=(",", ":")) for row in rows]
    text = json.dumps(head, indent=1)[:-2] + ',\n "simulations": [\n' + ",\n".join(lines) + "\n]}\n"
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_text(text)
    print(f"{FILE}: {len(rows)} simulations, {sum(v is not None for row in rows for v in row['values'])} values")


def commit(place: str) -> str:
    """The commit of a clone; what is no folder is a commit itself."""
    if not Path(place).is_dir():
        return place
    return subprocess.check_output(["git", "-C", place, "rev-parse", "HEAD"], text=True).strip()


def written(value: float | None):
    return str(value) if value is not None and math.isinf(value) else value


if __name__ == "__main__":
    main()
