#!/usr/bin/env python3
"""Print what the simulations of a run folder came to, as a sorted table, or the digest of that table.

    python3 tests/proof/run_table.py RUN...            # the table, a line per simulation
    python3 tests/proof/run_table.py --digest RUN...   # a line per planner and challenge: count, mean score, digest

A line holds scenario, planner, challenge, score, the score and the statistics of every metric, planning calls,
attempts, and a digest of each planner code. Measured times are left out, so equal programs give equal digests on any
machine. The script reads run folders of every format version, and needs nothing but Python 3.11.
"""

import argparse
import hashlib
import json
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

# The folder of the simulations: format version 2 and later, then version 1.
FOLDERS = ("simulations", "drives")


def digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def number(value) -> str:
    return "-" if value is None else repr(float(value))


def simulations(run: Path):
    for name in FOLDERS:
        if (run / name).is_dir():
            return sorted(path for path in (run / name).iterdir() if (path / "record.toml").is_file())
    sys.exit(f"{run} is no run folder: it has none of {', '.join(FOLDERS)}")


def metrics(folder: Path) -> list[str]:
    """The score of each metric and a digest of its statistics."""
    path = folder / "metrics.toml"
    if not path.is_file():
        return []
    cells = []
    for metric in tomllib.loads(path.read_text())["metrics"]:
        values = [f"{s['name']}={number(s['value'])}" for s in metric.get("statistics", [])]
        cells.append(f"{metric['name']}={number(metric.get('score'))}/{digest(' '.join(values))[:12]}")
    return sorted(cells)


def calls(folder: Path) -> list[str]:
    """Each planning call: its time, then a digest of the code of each attempt."""
    path = folder / "calls.jsonl"
    if not path.is_file():
        return []
    cells = []
    for line in path.read_text().splitlines():
        call = json.loads(line)
        codes = [(attempt.get("code") or {}).get("text", "-") for attempt in call["attempts"]]
        cells.append(f"{call['at_s']:.1f}:" + ",".join(digest(code)[:12] for code in codes))
    return cells


def row(folder: Path) -> tuple[str, str, str, float | None, str]:
    record = tomllib.loads((folder / "record.toml").read_text())
    made = calls(folder)
    attempts = sum(cell.split(":", 1)[1].count(",") + 1 for cell in made if not cell.endswith(":"))
    cells = [
        record["scenario"],
        record["planner"],
        record["challenge"],
        number(record.get("score")),
        *metrics(folder),
        f"calls={record['planning_calls']}",
        f"attempts={attempts}",
        *made,
    ]
    if record.get("error"):
        cells.append("failed")
    return record["scenario"], record["planner"], record["challenge"], record.get("score"), "\t".join(cells)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN")
    parser.add_argument("--digest", action="store_true", help="print a digest per planner and challenge")
    arguments = parser.parse_args()
    rows = sorted((row(folder) for run in arguments.runs for folder in simulations(run)), key=lambda r: r[4])
    if not arguments.digest:
        for cells in rows:
            print(cells[4])
        return
    groups = defaultdict(list)
    for cells in rows:
        groups[cells[1], cells[2]].append(cells)
    for (planner, challenge), members in sorted(groups.items()):
        scores = [score for *_, score, _ in members if score is not None]
        mean = f"{100 * sum(scores) / len(scores):.4f}" if scores else "-"
        print(planner, challenge, len(members), mean, digest("\n".join(cells[4] for cells in members)))


if __name__ == "__main__":
    main()
