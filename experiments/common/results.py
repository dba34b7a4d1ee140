"""Writes results: a table as CSV and its settings beside it, both in experiments/results/."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / "results"


def write_table(name: str, rows: list[dict[str, Any]], settings: dict[str, Any]) -> str:
    """Write rows and settings, and return the table as text."""
    FOLDER.mkdir(exist_ok=True)
    with (FOLDER / f"{name}.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    (FOLDER / f"{name}.json").write_text(json.dumps(settings, indent=1) + "\n")
    cells = [list(rows[0]), *([_cell(value) for value in row.values()] for row in rows)]
    widths = [max(len(row[k]) for row in cells) for k in range(len(cells[0]))]
    return "\n".join("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)) for row in cells)


def as_lines(values: dict[str, Any]) -> str:
    """A value a line, after what it is of."""
    width = max(map(len, values))
    return "\n".join(f"{name:{width}}  {_cell(value)}" for name, value in values.items())


def _cell(value: object) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)
