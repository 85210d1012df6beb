"""Tables for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ._results import Table

#: Rows of a table that a notebook shows.
SHOWN = 60


def html_rows(headers: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table of HTML."""
    head = "".join(f"<th>{escape(str(header))}</th>" for header in headers)
    body = "".join("<tr>" + "".join(f"<td>{escape(_cell(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_table(table: Table) -> str:
    """The first rows of a table."""
    columns = table.to_dict()
    rows = list(zip(*columns.values()))
    more = f"<p>{len(rows) - SHOWN} more rows</p>" if len(rows) > SHOWN else ""
    return html_rows(list(columns), rows[:SHOWN]) + more


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)
