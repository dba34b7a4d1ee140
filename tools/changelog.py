"""Print what CHANGELOG.md says of a version: `python tools/changelog.py 0.1.0`. A release's page has it."""

from __future__ import annotations

import re
import sys
from pathlib import Path

CHANGELOG = Path(__file__).parents[1] / "CHANGELOG.md"
_HEADING = re.compile(r"^## (?P<version>\S+), (?P<when>.+)$", re.MULTILINE)
_DAY = re.compile(r"\d{4}-\d\d-\d\d")


def section(changelog: str, version: str) -> str:
    """What stands below a version's heading. Raises ValueError where there is none, or no day on which it came out."""
    headings = list(_HEADING.finditer(changelog))
    for heading, after in zip(headings, [*headings[1:], None], strict=True):
        if heading["version"] != version:
            continue
        if not _DAY.fullmatch(heading["when"]):
            raise ValueError(f"{version} is {heading['when']}: its heading has to end with the day, as 2026-12-31")
        text = changelog[heading.end() : None if after is None else after.start()].strip()
        if not text:
            raise ValueError(f"{version} has nothing below its heading")
        return text + "\n"
    raise ValueError(f"{version} has no heading '## {version}, YYYY-MM-DD'")


if __name__ == "__main__":
    try:
        sys.stdout.write(section(CHANGELOG.read_text(encoding="utf-8"), sys.argv[1]))
    except ValueError as fault:
        sys.exit(f"{CHANGELOG.name}: {fault}")
