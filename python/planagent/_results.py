"""Results of runs."""

from __future__ import annotations

import csv
import os
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, SupportsIndex, overload

from . import _core
from ._arguments import path
from ._extras import installed
from ._html import html_rows, html_table
from .errors import RunError, SimulationsFailedWarning

if TYPE_CHECKING:
    import pandas
    import pyarrow

__all__ = ["Failure", "Mean", "Results", "Table"]


class Table:
    """A table of results. It has the Arrow PyCapsule interface, so pandas, polars, pyarrow and DuckDB read it.

    Examples
    --------
    >>> import planagent
    >>> table = planagent.simulate("generated/changing_lane/2", ["idm", "simple"]).table()
    >>> table.to_dict()["planner"]
    ['idm', 'simple']
    """

    __slots__ = ("_native",)
    _native: _core.Table

    def __init__(self) -> None:
        raise TypeError("tables come from Results.table and Results.statistics")

    @classmethod
    def _of(cls, native: _core.Table) -> Table:
        made = cls.__new__(cls)
        made._native = native
        return made

    def __len__(self) -> int:
        return len(self._native)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return _table, (list(zip(self.columns, self._native.kinds(), self.to_dict().values())),)

    def __getitem__(self, column: str) -> list[Any]:
        """A column as a list."""
        columns = self.to_dict()
        if column not in columns:
            raise KeyError(f"the table has no column {column!r}; it has {', '.join(columns)}")
        return columns[column]

    def __iter__(self) -> Iterator[dict[str, Any]]:
        """The rows as dictionaries, which pandas takes as data."""
        return iter(self.rows())

    def rows(self) -> list[dict[str, Any]]:
        """The rows as dictionaries.

        Examples
        --------
        >>> import planagent
        >>> table = planagent.simulate("generated/changing_lane/2", "idm").table()
        >>> table.rows()[0]["planner"]
        'idm'
        """
        columns = self.to_dict()
        return [dict(zip(columns, values)) for values in zip(*columns.values())]

    def _repr_html_(self) -> str:
        """The table in a notebook."""
        return html_table(self)

    def __repr__(self) -> str:
        return f"Table({len(self)} rows, {len(self.columns)} columns)"

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self._native.columns

    def to_dict(self) -> dict[str, list[Any]]:
        """The columns as lists; a missing value is `None`.

        Examples
        --------
        >>> import planagent
        >>> table = planagent.simulate("generated/changing_lane/2", "idm").table()
        >>> table.to_dict()["challenge"]
        ['nonreactive']
        """
        return self._native.to_dict()

    def __arrow_c_schema__(self) -> Any:
        """The schema as an Arrow capsule."""
        return self._native.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """The rows as an Arrow capsule."""
        return self._native.__arrow_c_stream__(requested_schema)

    def to_pyarrow(self) -> pyarrow.Table:
        """The table of pyarrow, which must be installed.

        Examples
        --------
        >>> import planagent
        >>> table = planagent.simulate("generated/changing_lane/2", "idm").table()
        >>> table.to_pyarrow().num_rows
        1
        """
        return installed("pyarrow", "Table.to_pyarrow").table(self)

    def to_pandas(self) -> pandas.DataFrame:
        """The frame of pandas, which must be installed. Numbers and counts have numeric types, also without any value.

        Examples
        --------
        >>> import planagent
        >>> table = planagent.simulate("generated/changing_lane/2", "idm").table()
        >>> table.to_pandas()["score"].dtype
        dtype('float64')
        """
        pandas = installed("pandas", "Table.to_pandas")
        kinds = {"number": "float64", "count": "int64", "truth": "object", "text": "object"}
        return pandas.DataFrame(
            {
                name: pandas.Series(values, dtype=kinds[kind] if kind in ("number", "count") else None)
                for (name, values), kind in zip(self.to_dict().items(), self._native.kinds())
            }
        )

    def to_csv(self, file: str | os.PathLike[str]) -> None:
        """Writes the table as CSV; a missing value is an empty cell.

        A text that a spreadsheet would compute begins with an apostrophe, as in the CSV of `planagent simulate`.

        Examples
        --------
        >>> import os, planagent, tempfile
        >>> table = planagent.simulate("generated/changing_lane/2", "idm").table()
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     table.to_csv(os.path.join(folder, "results.csv"))
        """
        columns = self.to_dict()
        with open(path("file", file), "w", newline="", encoding="utf-8") as out:
            writer = csv.writer(out, lineterminator="\n")
            writer.writerow([_cell(name) for name in columns])
            writer.writerows([[_cell(value) for value in row] for row in zip(*columns.values())])


#: What begins a formula, also in full width.
_FORMULA = re.compile("[\t\r\n]|(?:.*[\t\r\n])?\\s*[=+\\-@\uff1d\uff0b\uff0d\uff20]", re.DOTALL)


def _cell(value: Any) -> Any:
    """A value in a cell of CSV."""
    if value is None:
        return ""
    return f"'{value}" if isinstance(value, str) and _FORMULA.match(value) else value


def _table(columns: list[tuple[str, str, list[Any]]]) -> Table:
    return Table._of(_core.Table.of_columns(columns))


@dataclass(frozen=True)
class Failure:
    """A simulation that failed.

    Attributes
    ----------
    scenario, planner, challenge : str
        Which one.
    error : str
        Why, in a line.
    traceback : str or None
        The traceback of a planner in Python; `None` for others, and for results that were read from a folder.
    """

    scenario: str
    planner: str
    challenge: str
    error: str
    traceback: str | None


class Results:
    """The results of a run. An index or a loop gives the rows of `table()`.

    Attributes
    ----------
    folder : pathlib.Path or None
        The folder of the run; `None` for one whose files were not kept.
    missing : int
        How many scenarios of the splits the data lacks.

    Examples
    --------
    >>> import planagent
    >>> results = planagent.simulate("generated/changing_lane/2", ["idm", "simple"])
    >>> results
    Results(2 simulations)
    >>> len(results), results[0]["planner"], [row["planner"] for row in results]
    (2, 'idm', ['idm', 'simple'])
    """

    __slots__ = ("_native", "_tracebacks", "folder")

    def __init__(self, native: _core.RunResults, is_kept: bool, tracebacks: Mapping[str, str] | None = None) -> None:
        self._native = native
        self._tracebacks = dict(tracebacks or {})
        self.folder = Path(native.folder) if is_kept else None

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        native = self._native
        stored = (str(native.folder), native.to_bytes(), native.missing, native.total)
        return _results, (stored, self.folder, self._tracebacks)

    def __len__(self) -> int:
        return len(self.table())

    @overload
    def __getitem__(self, index: SupportsIndex) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> list[dict[str, Any]]: ...
    def __getitem__(self, index: SupportsIndex | slice) -> Any:
        """A row of `table()` as a dictionary."""
        return self.table().rows()[index]

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self.table().rows())

    def __repr__(self) -> str:
        return f"Results({self._said()}{'' if self.folder is None else f', folder={str(self.folder)!r}'})"

    def _said(self) -> str:
        errors = self.table()["error"]
        failed = sum(error is not None for error in errors)
        parts = [f"{len(errors)} simulation{'' if len(errors) == 1 else 's'}"]
        if failed:
            parts.append(f"{failed} failed")
        if len(errors) < self._native.total:
            parts.append(f"{self._native.total - len(errors)} not simulated")
        return ", ".join(parts)

    def _repr_html_(self) -> str:
        """The results in a notebook: the means, and why simulations failed."""
        rows = [
            [planner, challenge, "-" if mean.score is None else f"{mean.score:.4f}", f"{mean.scored}", f"{mean.failed}"]
            for (planner, challenge), mean in self.means().items()
        ]
        means = html_rows(["planner", "challenge", "mean score", "scored", "failed"], rows)
        failures = "".join(f"<li>{escape(failure.scenario)}: {escape(failure.error)}</li>" for failure in self.failures[:10])
        return f"<p>{escape(self._said())}</p>{means}" + (f"<ul>{failures}</ul>" if failures else "")

    @property
    def missing(self) -> int:
        """How many scenarios of the splits the data lacks."""
        return self._native.missing

    @property
    def is_complete(self) -> bool:
        """Whether all simulations of the run are completed."""
        return len(self) >= self._native.total

    @property
    def failures(self) -> list[Failure]:
        """The simulations that failed, with the tracebacks of planners in Python."""
        return [
            Failure(row["scenario"], row["planner"], row["challenge"], row["error"], self._traceback(row["error"]))
            for row in self
            if row["error"] is not None
        ]

    def _traceback(self, error: str) -> str | None:
        # The error of a simulation says what was done, then what the planner raised.
        return next((text for line, text in self._tracebacks.items() if line in error), None)

    def table(self) -> Table:
        """A row for each simulation: its score, the scores of the metrics, its error, and how it was planned.

        The columns are those of `planagent simulate --csv`, with `scenario`, the name that `open` takes, and `seconds` beside them.

        Examples
        --------
        >>> import planagent
        >>> planagent.simulate("generated/changing_lane/2", ["idm", "simple"]).table()["planner"]
        ['idm', 'simple']
        """
        return Table._of(self._native.table())

    def statistics(self) -> Table:
        """A row for each statistic of each metric of each simulation, as nuPlan computes them.

        The columns are `scenario`, `planner`, `challenge`, `metric`, `metric_score`, `statistic`, `value` and `unit`. They come from the folder of
        the run.

        Examples
        --------
        >>> import os, planagent, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     results = planagent.simulate("generated/changing_lane/2", "idm", out=os.path.join(folder, "run"))
        ...     "ego_lon_jerk" in results.statistics()["metric"]
        True
        """
        if self.folder is None:
            raise RunError("the files of this run were not kept; name a folder by out, and read it by planagent.open_run")
        return Table._of(_core.statistics(str(self.folder)))

    def means(self) -> dict[tuple[str, str], Mean]:
        """The mean score of each planner in each challenge, and over how many simulations.

        Examples
        --------
        >>> import planagent
        >>> results = planagent.simulate("generated/changing_lane/2", "log-replay")
        >>> results.means()["log-replay", "nonreactive"].scored
        1
        """
        scores: dict[tuple[str, str], list[float | None]] = {}
        for row in self:
            scores.setdefault((row["planner"], row["challenge"]), []).append(row["score"])
        return {key: Mean.of(values) for key, values in scores.items()}

    def mean_scores(self) -> dict[tuple[str, str], float]:
        """The mean score of each planner in each challenge. A warning says which leave out simulations that failed.

        Examples
        --------
        >>> import planagent
        >>> results = planagent.simulate("generated/changing_lane/2", "log-replay")
        >>> list(results.mean_scores())
        [('log-replay', 'nonreactive')]
        """
        means = self.means()
        partial = [f"{planner} ({challenge}): {mean.failed} of {mean.failed + mean.scored}" for (planner, challenge), mean in means.items() if mean.failed]
        if partial:
            _warn(f"these means leave out simulations that failed: {'; '.join(partial)}. See Results.failures")
        return {key: mean.score for key, mean in means.items() if mean.score is not None}

    def warn(self) -> None:
        """Warns of simulations that failed.

        Examples
        --------
        >>> import planagent
        >>> planagent.simulate("generated/changing_lane/2", "idm").warn()
        """
        failures = self.failures
        if failures:
            _warn(f"{self._said()}; the first: {failures[0].scenario} by {failures[0].planner}: {failures[0].error}. See Results.failures")

    def report(self, out: str | os.PathLike[str] | None = None) -> Path:
        """Writes the page of the run and gives its path; by default `report.html` in the folder of the run.

        Examples
        --------
        >>> import os, planagent, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     results = planagent.simulate("generated/changing_lane/2", "idm", out=os.path.join(folder, "run"))
        ...     results.report().name
        'report.html'
        """
        if self.folder is None:
            raise RunError("the files of this run were not kept, and a page needs them; name a folder by out")
        place = self.folder / "report.html" if out is None else Path(path("out", out))
        _core.write_report(str(self.folder), str(place))
        return place

    def plot(self, axes: Any = None) -> Any:
        """Draws the mean score of each planner in each challenge as bars with matplotlib, which must be installed; gives the axes.

        Examples
        --------
        >>> import planagent
        >>> results = planagent.simulate("generated/changing_lane/2", ["idm", "simple"])
        >>> results.plot().get_ylabel()  # doctest: +SKIP
        'mean score'
        """
        if axes is None:
            axes = installed("matplotlib.pyplot", "Results.plot").subplots()[1]
        means = self.means()
        planners = list(dict.fromkeys(planner for planner, _ in means))
        challenges = list(dict.fromkeys(challenge for _, challenge in means))
        width = 0.8 / max(1, len(challenges))
        for number, challenge in enumerate(challenges):
            of = [means.get((planner, challenge)) for planner in planners]
            places = [place + (number - (len(challenges) - 1) / 2) * width for place in range(len(planners))]
            axes.bar(places, [0.0 if mean is None or mean.score is None else mean.score for mean in of], width, label=challenge)
            for place, mean in zip(places, of):
                if mean is not None and mean.failed:
                    axes.annotate(f"{mean.failed} failed", (place, mean.score or 0.0), ha="center", va="bottom")
        axes.set_xticks(range(len(planners)), planners)
        axes.set_ylabel("mean score")
        axes.set_ylim(0.0, 1.0)
        axes.legend()
        return axes


@dataclass(frozen=True)
class Mean:
    """A mean score.

    Attributes
    ----------
    score : float or None
        The mean over the simulations that have a score; `None` where none has.
    scored, failed : int
        How many simulations have one, and how many failed.
    """

    score: float | None
    scored: int
    failed: int

    @classmethod
    def of(cls, scores: list[float | None]) -> Mean:
        """The mean of scores; those of failures are `None`."""
        known = [score for score in scores if score is not None]
        return cls(sum(known) / len(known) if known else None, len(known), len(scores) - len(known))


def _results(stored: tuple[str, bytes, int, int], folder: Path | None, tracebacks: dict[str, str]) -> Results:
    made = Results(_core.RunResults.of_bytes(*stored), folder is not None, tracebacks)
    made.folder = folder
    return made


def _warn(text: str) -> None:
    """Warns at the line of the user."""
    level, frame = 1, sys._getframe(0)
    while frame is not None and frame.f_globals.get("__name__", "").split(".")[0] == "planagent":
        frame, level = frame.f_back, level + 1  # type: ignore[assignment]
    warnings.warn(text, SimulationsFailedWarning, stacklevel=level)
