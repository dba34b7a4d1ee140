"""Tables in markdown."""

from __future__ import annotations

from typing import Any


def markdown(rows: list[dict[str, Any]], digits: int = 3) -> str:
    """A line for each row, a column for each of their keys."""
    lines = [list(rows[0]), ["---"] * len(rows[0]), *([_cell(value, digits) for value in row.values()] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _cell(value: object, digits: int) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}f}" if isinstance(value, float) else str(value)
