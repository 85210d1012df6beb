"""Compares the values of two programs, and prints tables of what differs."""

import math
from collections import Counter
from dataclasses import dataclass, field

# Values that differ by no more are the same number in another order of operations.
SAME = 1e-6
# Values of the tracker's state may differ by so much: it is a filter of the poses.
CLOSE = 1e-3
# Metrics that are derived from the tracker's accelerations and yaw rates.
TRACKER = (
    "ego_acceleration",
    "ego_is_comfortable",
    "ego_jerk",
    "ego_lat_acceleration",
    "ego_lat_jerk",
    "ego_lon_acceleration",
    "ego_lon_jerk",
    "ego_yaw_acceleration",
    "ego_yaw_rate",
)
# Of a score of 100.
SAME_SCORE = 0.01
# Share of the values that have to agree.
REACH = 0.99


@dataclass
class Difference:
    """A value that differs by more than `SAME`; a missing value is None."""

    metric: str
    devkit: float | None
    ours: float | None

    @property
    def distance(self) -> float:
        if self.devkit is None or self.ours is None:
            return math.inf
        return abs(self.devkit - self.ours)

    @property
    def allowed(self) -> bool:
        return self.metric.split("/")[0] in TRACKER and self.distance <= CLOSE


@dataclass
class Compared:
    """A simulation by both programs."""

    scenario: str
    planner: str
    challenge: str
    # Its error, where the devkit or our program failed.
    devkit_error: str | None = None
    our_error: str | None = None
    values: int = 0
    differences: list[Difference] = field(default_factory=list)
    # Scores of 100.
    devkit_score: float | None = None
    our_score: float | None = None
    # Time series: values, and the largest difference by metric.
    series_values: int = 0
    series: dict[str, float] = field(default_factory=dict)

    @property
    def score_difference(self) -> float:
        if self.devkit_score is None or self.our_score is None:
            return 0.0 if self.devkit_score == self.our_score else math.inf
        return abs(self.devkit_score - self.our_score)

    @property
    def both(self) -> bool:
        return self.devkit_error is None and self.our_error is None


def same(a: float | None, b: float | None) -> bool:
    return a == b or (a is not None and b is not None and abs(a - b) <= SAME)


def compare(scenario: str, planner: str, challenge: str, devkit: dict, ours: dict | None) -> Compared:
    """Compares a simulation. Statistics that only one program has count as different."""
    found = Compared(scenario, planner, challenge, devkit_error=devkit.get("error"))
    if ours is None:
        found.our_error = "no result"
    if not found.both:
        return found
    theirs, own = devkit["values"], ours["values"]
    # A metric that nuPlan's challenge does not list is ours alone.
    metrics = {name.split("/")[0] for name in theirs}
    names = [*theirs, *(name for name in own if name not in theirs and name.split("/")[0] in metrics)]
    for name in names:
        a, b = theirs.get(name), own.get(name)
        # Neither program has a score of a metric that only reports, nor a statistic that does not apply.
        found.values += a is not None or b is not None
        if not same(a, b):
            found.differences.append(Difference(name, a, b))
    found.devkit_score, found.our_score = (None if s is None else 100 * s for s in (devkit["score"], ours["score"]))
    for name, series in devkit["series"].items():
        found.series_values += len(series)
        other = ours["series"].get(name)
        if other is None or len(other) != len(series):
            found.series[name] = math.inf
            continue
        worst = max((Difference(name, a, b).distance for a, b in zip(series, other) if not same(a, b)), default=0.0)
        if worst > 0:
            found.series[name] = worst
    return found


@dataclass
class Reach:
    """What the comparison came to."""

    values: int
    agreeing: int
    scores_apart: int
    our_failures: int

    @property
    def reached(self) -> bool:
        enough = self.values > 0 and self.agreeing >= REACH * self.values
        return enough and self.scores_apart == 0 and self.our_failures == 0


def reach(compared: list[Compared]) -> Reach:
    both = [one for one in compared if one.both]
    values = sum(one.values for one in both)
    apart = sum(not d.allowed for one in both for d in one.differences)
    return Reach(
        values=values,
        agreeing=values - apart,
        scores_apart=sum(one.score_difference > SAME_SCORE for one in both),
        our_failures=sum(one.our_error is not None and one.devkit_error is None for one in compared),
    )


def summary(compared: list[Compared]) -> list[dict]:
    """A row for each planner and challenge, and one for all."""
    groups: dict[str, list[Compared]] = {}
    for one in compared:
        groups.setdefault(f"{one.planner} {one.challenge}", []).append(one)
    groups["all"] = compared
    rows = []
    for name, group in groups.items():
        both = [one for one in group if one.both]
        distances = [d.distance for one in both for d in one.differences]
        rows.append(
            {
                "name": name,
                "simulations": len(both),
                "failed in the devkit": sum(one.devkit_error is not None for one in group),
                "values": sum(one.values for one in both),
                "> 1e-6": len(distances),
                "> 1e-3": sum(distance > CLOSE for distance in distances),
                "in simulations": sum(bool(one.differences) for one in both),
                "scores apart": sum(one.score_difference > SAME_SCORE for one in both),
                "largest score difference": max((one.score_difference for one in both), default=0.0),
                "time series values": sum(one.series_values for one in both),
            }
        )
    return rows


def table(compared: list[Compared]) -> str:
    """The summary as Markdown."""
    rows = summary(compared)
    head = [name for name in rows[0] if name != "name"]
    lines = ["| planner, challenge | " + " | ".join(head) + " |", "|---" * (len(head) + 1) + "|"]
    for row in rows:
        cells = [f"{row[name]:.2g}" if isinstance(row[name], float) else str(row[name]) for name in head]
        lines.append(f"| {row['name']} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def remaining(compared: list[Compared], most: int) -> str:
    """Every simulation that differs, the worst first, with up to `most` of its values."""
    lines = []
    for one in sorted(compared, key=lambda one: -max((d.distance for d in one.differences), default=0.0)):
        name = f"{one.scenario} {one.planner} {one.challenge}"
        if one.both and (one.differences or one.series):
            scores = f"score {text(one.devkit_score)} / {text(one.our_score)}"
            lines.append(f"{name}: {len(one.differences)} of {one.values} values, {scores} (devkit / ours)")
            worst = sorted(one.differences, key=lambda d: -d.distance)
            lines += [f"    {d.metric}: {text(d.devkit)} / {text(d.ours)}" for d in worst[:most]]
            hidden = {m: w for m, w in one.series.items() if all(d.metric.split("/")[0] != m for d in one.differences)}
            lines += [f"    {metric}: only its time series, by up to {w:.3g}" for metric, w in hidden.items()]
    errors = Counter()
    for one in compared:
        if one.our_error is not None and one.devkit_error is None:
            lines.append(f"{one.scenario} {one.planner} {one.challenge}: ours failed: {one.our_error}")
        if one.devkit_error is not None:
            state = "ours failed too" if one.our_error else "ours did not fail"
            errors[f"{one.scenario} {one.planner} {one.challenge}: {one.devkit_error[:200]} ({state})"] += 1
    if errors:
        lines += ["", "Failed in the devkit:", *errors]
    return "\n".join(lines)


def text(value: float | None) -> str:
    return "none" if value is None else f"{value:.9g}"
