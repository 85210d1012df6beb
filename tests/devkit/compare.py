#!/usr/bin/env python3
"""Compare our program with nuplan-devkit and tuplan_garage, simulation by simulation and value by value.

    python tests/devkit/compare.py --program target/release/planagent --devkit CLONE --tuplan CLONE --out FOLDER

Both programs read the same files: `planagent scenarios export` writes them to FOLDER/exported. The devkit's results
are kept in FOLDER/devkit under a digest of log and map, so that a stopped comparison continues, and a new version of
our program compares at once. Tables go to stdout, progress to stderr. The exit code is 1 if the programs differ by
more than `comparison.py` allows. docs/devkit.md names the packages and the result.
"""

import argparse
import dataclasses
import gzip
import json
import os
import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

import comparison
import our_rules
import our_side
from devkit_side import CHALLENGES, PLANNERS, Devkit

# Simulations of a process before a new one takes its place: the devkit keeps the maps it has opened.
SIMULATIONS_PER_PROCESS = 60
# Differing values that are printed for a simulation.
MAX_VALUES = 6


@dataclasses.dataclass(frozen=True)
class Task:
    """A simulation that the devkit has to make, and the file of its result."""

    scenario: our_side.ExportedScenario
    planner: str
    challenge: str
    result: Path


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, required=True, help="our program")
    parser.add_argument("--devkit", type=Path, required=True, help="a clone of nuplan-devkit")
    parser.add_argument("--tuplan", type=Path, help="a clone of tuplan_garage, for pdm-closed")
    parser.add_argument("--out", type=Path, required=True, help="folder for exports and results")
    parser.add_argument("--scenarios", nargs="*", metavar="SCENARIO", help="[default: all generated types]")
    parser.add_argument("--seeds", default=",".join(map(str, our_side.SEEDS)), help="of the generated types")
    parser.add_argument("--recordings", type=Path, metavar="FOLDER", help="data folder with womd and argoverse2")
    parser.add_argument("--planner", default=",".join(PLANNERS))
    parser.add_argument("--challenge", default="both", choices=["both", *CHALLENGES])
    parser.add_argument("--workers", type=int, default=1, help="processes of the devkit")
    parser.add_argument("--limit", type=int, help="make so many simulations of the devkit, then compare")
    parser.add_argument("--export", action="append", default=[], metavar="FLAG", help="more flags for the export")
    parser.add_argument("--only-compare", action="store_true", help="take the results that are there")
    parser.add_argument(
        "--our-rules", action="store_true", help="then make what differs again with our rules in the devkit"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all compared values")
    parser.add_argument("--time", type=int, metavar="N", help="measure both programs N times instead")
    options = parser.parse_args()
    if "pdm-closed" in options.planner.split(",") and options.tuplan is None:
        parser.error("pdm-closed needs --tuplan, or name other planners with --planner")
    for clone, package in ((options.devkit, "nuplan"), (options.tuplan, "tuplan_garage")):
        if clone is not None and not (clone / package).is_dir():
            parser.error(f"{clone} has no folder {package}; name a clone of the project")
    return options


def main() -> int:
    options = arguments()
    prepare(options)
    planners = options.planner.split(",")
    challenges = [*CHALLENGES] if options.challenge == "both" else [options.challenge]
    exported = options.out / "exported"
    options.out.mkdir(parents=True, exist_ok=True)
    scenarios = our_side.export(options.program, sources(options), exported, options.export)
    if options.time:
        return measure(options, exported, scenarios, planners, challenges)
    say(f"{len(scenarios)} scenarios in {exported}; our simulations")
    run = options.out / "run"
    our_side.simulate(options.program, exported, scenarios, run, planners, challenges)
    ours = our_side.results(run)
    tasks = tasks_of(options, scenarios, planners, challenges)
    if not options.only_compare:
        simulate_missing(options, exported, tasks)
    compared = {task: compared_with(task, ours) for task in tasks if task.result.is_file()}
    code = report(options, list(compared.values()), len(tasks))
    if options.our_rules:
        again = with_our_rules(options, [task for task, one in compared.items() if one.differences or one.series])
        if not options.only_compare:
            simulate_missing(options, exported, again, ours=True)
        say("what differed, with our rules in the devkit:")
        print(f"\n{comparison.table([compared_with(task, ours) for task in again if task.result.is_file()])}")
    return code


def compared_with(task: Task, ours: dict) -> comparison.Compared:
    """The result of a task beside ours."""
    devkit = json.loads(gzip.decompress(task.result.read_bytes()))
    own = ours.get((task.scenario.token, task.planner, task.challenge))
    return comparison.compare(task.scenario.name, task.planner, task.challenge, devkit, own)


def with_our_rules(options: argparse.Namespace, tasks: list[Task]) -> list[Task]:
    """The same simulations with results of their own."""
    folder = options.out / "devkit-our-rules"
    folder.mkdir(exist_ok=True)
    return [dataclasses.replace(task, result=folder / task.result.name) for task in tasks]


def prepare(options: argparse.Namespace) -> None:
    """Makes the two projects importable, here and in every process."""
    paths = [str(path.resolve()) for path in (options.devkit, options.tuplan) if path is not None]
    sys.path[:0] = paths
    os.environ["PYTHONPATH"] = os.pathsep.join([*paths, os.environ.get("PYTHONPATH", "")])
    # Two programs are compared on one core each: no library starts threads of its own.
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")


def sources(options: argparse.Namespace) -> list[str]:
    """The scenarios in the order of their simulations: a seed of each type first, so that an early stop shows most."""
    recorded = our_side.recordings(options.recordings) if options.recordings else []
    if options.scenarios is not None:
        return options.scenarios + recorded
    types = our_side.generated_types(options.program)
    found = [f"generated/{kind}/{seed}" for seed in options.seeds.split(",") for kind in types]
    return found[: len(types)] + recorded + found[len(types) :]


def tasks_of(options, scenarios, planners, challenges) -> list[Task]:
    """The simulations in the order in which they are made: the cheap planners first."""
    folder = options.out / "devkit"
    folder.mkdir(exist_ok=True)
    groups = [[planner for planner in planners if planner != "pdm-closed"], ["pdm-closed"] * ("pdm-closed" in planners)]
    return [
        Task(scenario, planner, challenge, folder / f"{scenario.digest}-{planner}-{challenge}.json.gz")
        for group in groups
        for scenario in scenarios
        for challenge in challenges
        for planner in group
    ]


def simulate_missing(options: argparse.Namespace, exported: Path, tasks: list[Task], ours: bool = False) -> None:
    missing = [task for task in tasks if not task.result.is_file()][: options.limit]
    say(f"{len(tasks)} simulations, {len(missing)} to be made by the devkit")
    start = time.monotonic()
    done = 0
    # A pool that replaces its processes (`max_tasks_per_child`) hangs now and then in Python 3.11.
    for first in range(0, len(missing), SIMULATIONS_PER_PROCESS * options.workers):
        batch = missing[first : first + SIMULATIONS_PER_PROCESS * options.workers]
        with ProcessPoolExecutor(
            options.workers, get_context("spawn"), initializer=start_process, initargs=(options.devkit, exported, ours)
        ) as pool:
            running = {pool.submit(simulate, task): task for task in batch}
            for future in as_completed(running):
                done += 1
                task, error = running[future], future.result()
                name = f"{task.scenario.name} {task.planner} {task.challenge}"
                say(f"{done}/{len(missing)} {time.monotonic() - start:.0f} s  {name}{f': {error}' if error else ''}")


def start_process(devkit: Path, exported: Path, ours: bool) -> None:
    global DEVKIT
    DEVKIT = Devkit(devkit, exported)
    if ours:
        our_rules.apply()


def simulate(task: Task) -> str | None:
    """Makes one simulation and writes its result; its error."""
    result = DEVKIT.simulate(task.scenario.token, task.planner, task.challenge)
    part = task.result.with_suffix(".part")
    part.write_bytes(gzip.compress(json.dumps(result).encode(), 6))
    part.rename(task.result)
    return result.get("error")


def report(options: argparse.Namespace, compared: list[comparison.Compared], wanted: int) -> int:
    if not compared:
        say("nothing to compare")
        return 1
    print(comparison.table(compared))
    print()
    print(comparison.remaining(compared, MAX_VALUES))
    reach = comparison.reach(compared)
    share = 100 * reach.agreeing / max(reach.values, 1)
    said = "reached" if reach.reached else "MISSED"
    print(
        f"\n{said}: {share:.3f} % of {reach.values} values agree, {reach.scores_apart} scores apart, "
        f"{len(compared)} of {wanted} simulations compared"
    )
    if options.json:
        rows = [dataclasses.asdict(one) for one in compared]
        options.json.write_text(json.dumps({"summary": comparison.summary(compared), "simulations": rows}, indent=1))
    return 0 if reach.reached else 1


def measure(options, exported, scenarios, planners, challenges) -> int:
    """Both programs in turn on the same simulations, one process and one thread each: medians of N."""
    devkit = Devkit(options.devkit, exported)
    print("| scenario, planner, challenge | devkit ms/step | ours ms/step | devkit s/simulation | ours s/simulation |")
    print("|---|---|---|---|---|")
    for scenario in scenarios:
        # The devkit opens a map once for all simulations on it.
        devkit.simulate(scenario.token, "simple", challenges[0])
        for planner, challenge in ((planner, challenge) for planner in planners for challenge in challenges):
            theirs, own = [], []
            for number in range(options.time):
                result = devkit.simulate(scenario.token, planner, challenge)
                if "error" in result:
                    say(f"{scenario.name} {planner} {challenge}: {result['error']}")
                    break
                theirs.append((statistics.median(result["step_ms"]), result["wall_s"]))
                run = options.out / "time"
                own.append(our_side.timed(options.program, exported, scenario, planner, challenge, run))
                say(f"{scenario.name} {planner} {challenge} {number + 1}/{options.time}: {theirs[-1]} {own[-1]}")
            else:
                cells = [statistics.median(pair[place] for pair in side) for place in (0, 1) for side in (theirs, own)]
                measured = " | ".join(f"{cell:.3g}" for cell in cells)
                print(f"| {scenario.name} {planner} {challenge} | {measured} |", flush=True)
    return 0


def say(what: str) -> None:
    print(what, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
