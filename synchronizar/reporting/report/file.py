"""Puts the report's page, its style, its scripts and its data into one file."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from pathlib import Path
from typing import Any

from synchronizar.data.recording import Recording
from synchronizar.errors import os_faults
from synchronizar.io.registration_reader import read_registration
from synchronizar.io.updates_jsonl import UPDATES_FILE, read_updates
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.history import history_of
from synchronizar.reporting.report.values import report_values

REPORT = "report.html"
PAGE = Path(__file__).parent / "page"
SCRIPTS = ("values", "svg", "words", "choice", "tip", "map", "lanes", "residuals", "pairs", "tables", "main")
"""The page's modules, each after those it imports from."""
_IMPORT = re.compile(r'^import (\{[^}]*\}) from "\./(\w+)\.js";$', re.MULTILINE)
_EXPORT = re.compile(r"^export ((?:const|function) (\w+))", re.MULTILINE)


def write_report(recording: Recording, folder: str | Path, name: str) -> Path:
    """Write the report of what `register --out` or `replay --out` wrote into a folder; return its path.

    `name` is the recording's, for the title. Raises InputError where the folder holds no answer, or one about another
    recording, or where the file cannot be written.
    """
    file, updates = Path(folder) / REPORT, Path(folder) / UPDATES_FILE
    replayed = updates.exists()  # only a replay writes it
    history = history_of(read_updates(updates, recording), recording) if replayed else None
    registration, tracks = read_registration(Path(folder), recording, causal=replayed)
    answer = Answer(registration, tracks, recording.tracks, recording.ranges)
    text = report_html(report_values(answer, history, name))
    with os_faults(file):
        file.write_text(text, encoding="utf-8")
    return file


def report_html(values: dict[str, Any]) -> str:
    """The whole page. Its policy lets nothing be loaded and no other script run."""
    style = (PAGE / "report.css").read_text(encoding="utf-8")
    script = "\n".join(["const modules = {};", *map(_scope, SCRIPTS)])
    # `<` would let a name end the element that the data stand in.
    data = json.dumps(values, separators=(",", ":"), allow_nan=False, ensure_ascii=False).replace("<", "\\u003c")
    parts = {
        "policy": f"default-src 'none'; script-src '{_digest(script)}'; style-src '{_digest(style)}'",
        "title": html.escape(values["title"]),
        "style": style,
        "data": data,
        "script": script,
    }
    page = (PAGE / "report.html").read_text(encoding="utf-8")
    return re.sub(r"\{\{(\w+)\}\}", lambda place: parts[place[1]], page)


def _scope(name: str) -> str:
    """A module as a function that is called once and returns what the module exports: one file has no other modules."""
    text = (PAGE / f"{name}.js").read_text(encoding="utf-8")
    exported = ", ".join(match[2] for match in _EXPORT.finditer(text))
    body = _EXPORT.sub(r"\1", _IMPORT.sub(r"const \1 = modules.\2;", text))
    return f"modules.{name} = (() => {{\n{body}\nreturn {{ {exported} }};\n}})();"


def _digest(text: str) -> str:
    """As a content security policy names what stands in the page itself."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
