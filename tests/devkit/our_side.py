"""Exports by `planagent scenarios export`, and simulations by `planagent simulate` on what it wrote."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from devkit_side import CHALLENGES, read_results

# Seeds of the generated scenarios that are compared by default.
SEEDS = (3, 7, 11, 13, 17)
# The list of the scenarios in an exported folder; `export` writes it.
LISTING = "scenarios.json"


@dataclass(frozen=True)
class ExportedScenario:
    """A scenario in nuPlan's files."""

    # As `planagent` takes it: generated/TYPE/SEED or a file.
    source: str
    # Short name for tables.
    name: str
    token: str
    log: Path
    # Digest of its log and its map.
    digest: str


def program(binary: Path, *words: str, maps: Path | None = None) -> str:
    """Runs `planagent`; its stdout. A failure ends this program with what `planagent` says."""
    environment = dict(os.environ)
    if maps is not None:
        environment["NUPLAN_MAPS_ROOT"] = str(maps)
        environment["PLANAGENT_CACHE"] = str(maps.parent / "cache")
    ran = subprocess.run([binary, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)
    if ran.returncode not in (0, 1):
        sys.exit(f"planagent {' '.join(words[:6])} ... failed:\n{ran.stderr}")
    return ran.stdout


def generated_types(binary: Path) -> list[str]:
    """Every type of the scene generator."""
    lines = program(binary, "scenarios", "list", "--json").splitlines()
    return sorted({json.loads(line)["scenario_type"] for line in lines})


def recordings(data: Path) -> list[str]:
    """The recordings of the tests in a data folder."""
    patterns = ("womd/*.tfrecord", "argoverse2/sensor/*", "argoverse2/motion_forecasting/*")
    return [str(path) for pattern in patterns for path in sorted(data.glob(pattern))]


def export(binary: Path, sources: list[str], folder: Path, extra: list[str]) -> list[ExportedScenario]:
    """Exports the scenarios into a new folder, or takes the folder's files if they have all of them."""
    listing = folder / LISTING
    if listing.is_file() and not set(sources) <= set(json.loads(listing.read_text())["sources"]):
        shutil.rmtree(folder)
    if not listing.is_file():
        options = ["--format", "nuplan", "--stand-in-maps", "--out", str(folder), "--json", *extra]
        lines = program(binary, "scenarios", "export", *sources, *options).splitlines()
        logs = [json.loads(line) for line in lines]
        if len(logs) != len(sources):
            sys.exit(f"{len(sources)} scenarios were to be exported, and {len(logs)} were; name single scenarios")
        listing.write_text(json.dumps({"sources": sources, "logs": logs}, indent=1))
    known = {one.source: one for one in exported_scenarios(folder)}
    return [known[source] for source in sources]


def exported_scenarios(folder: Path) -> list[ExportedScenario]:
    """The scenarios of an exported folder."""
    known = json.loads((folder / LISTING).read_text())
    sources, logs = known["sources"], known["logs"]
    digests = {}
    found = []
    for source, log in zip(sources, logs, strict=True):
        location = log["location"]
        if location not in digests:
            [package] = (folder / "maps" / location).rglob("map.gpkg")
            digests[location] = digest(package.read_bytes())
        path = folder / "data" / f"{log['log']}.db"
        own = digest(path.read_bytes() + digests[location].encode())
        found.append(ExportedScenario(source, short(source), log["token"], path, own))
    return found


def short(source: str) -> str:
    """A scenario's name in tables: TYPE/SEED, or the file's stem."""
    return source.removeprefix("generated/") if source.startswith("generated/") else Path(source).stem[:16]


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def simulate(
    binary: Path, folder: Path, scenarios: list[ExportedScenario], run: Path, planners: list[str], challenges: list[str]
) -> None:
    """Simulates exported scenarios into a new run folder."""
    if run.exists():
        shutil.rmtree(run)
    both = "both" if len(challenges) > 1 else challenges[0]
    logs = [str(one.log) for one in scenarios]
    words = ["--scenario", *logs, "--planner", ",".join(planners), "--challenge", both]
    program(binary, "simulate", *words, "--out", str(run), "--quiet", maps=folder / "maps")


def results(run: Path) -> dict:
    """What our program wrote, by token, planner and challenge."""
    found = {}
    for ours, theirs in CHALLENGES.items():
        for (token, planner), result in read_results(run / theirs).items():
            found[token, planner, ours] = result
    return found


def timed(binary: Path, folder: Path, scenario: ExportedScenario, planner: str, challenge: str, run: Path):
    """Milliseconds a step (median) and seconds of one simulation on one thread, as our own report has them."""
    import pandas

    if run.exists():
        shutil.rmtree(run)
    place = f"{scenario.log}#{scenario.token}"
    words = ["--scenario", place, "--planner", planner, "--challenge", challenge, "--threads", "1"]
    program(binary, "simulate", *words, "--out", str(run), "--quiet", maps=folder / "maps")
    [report] = run.rglob("runner_report.parquet")
    row = pandas.read_parquet(report).iloc[0]
    return 1000 * row["compute_trajectory_runtimes_median"], row["duration"]
