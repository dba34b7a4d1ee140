"""Writes docs/protocol.md from the message types: `python tools/protocol_page.py [--check]`."""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from synchronizar.live import budget, messages, pose_wire

PAGE = Path(__file__).parent.parent / "docs" / "protocol.md"
BEGIN = PAGE.parent.parent / "tools" / "protocol_begin.txt"


def main() -> int:
    """Write the page, or with `--check` say whether it is up to date."""
    text = page()
    if "--check" in sys.argv[1:]:
        if PAGE.read_text(encoding="utf-8") != text:
            print(f"{PAGE} is not what the messages say: run python tools/protocol_page.py", file=sys.stderr)
            return 1
        return 0
    PAGE.write_text(text, encoding="utf-8")
    return 0


def page() -> str:
    """The whole page."""
    begin = (
        BEGIN.read_text(encoding="utf-8")
        .replace("{most_users}", str(messages.MOST_USERS))
        .replace("{most_ranges}", str(messages.MOST_RANGES))
        .replace("{most_poses}", str(pose_wire.MOST_POSES))
        .replace("{largest}", str(messages.LARGEST_MESSAGE // 1024))
        .replace("{data}", str(messages.LARGEST_DATA // 1024))
        .replace("{words}", str(budget.WORDS_A_SECOND))
        .replace("{bytes}", str(budget.BYTES_A_SECOND // 1024))
        .replace("{measured}", str(budget.MEASURED_A_SECOND))
        .replace("{handed}", str(budget.HANDED_ON_A_SECOND))
    )
    parts = [begin, "## Joining, by HTTPS\n\n"]
    parts += [_section(kind) for kind in (messages.Join, messages.UserSettings, messages.Joined)]
    parts.append("## From a client\n\n")
    parts += [_section(kind) for kind in get_args(messages.FromClient)]
    parts.append(_section(messages.MeasuredRange))
    parts.append("## From the room\n\n")
    parts += [_section(kind) for kind in get_args(messages.FromRoom)]
    inner = (messages.Member, messages.UserFrame, messages.Object, messages.PairRange, messages.Health, messages.Lag)
    parts += [_section(kind) for kind in inner]
    parts.append(
        "## Poses, in bytes\n\nAll numbers are little-endian; f4 and f8 are IEEE 754 floats of 4 and 8 bytes.\n\n"
    )
    described = {name: _with_kinds(text) for name, text in _described_constants().items()}
    parts.append(_layout("A device's pose", pose_wire.UP, described["UP"], 0))
    head = "kind u1, reserved u1, count u2, sequence u4, t f8: "
    parts.append(f"### The head of everybody's poses\n\n{head}{_plain(described['DOWN_HEAD'])}\n\n")
    parts.append(_layout("Each device after it", pose_wire.DOWN, described["DOWN"], pose_wire.DOWN_HEAD.size))
    states = ", ".join(f"{i} {state}" for i, state in enumerate(pose_wire.STATES))
    parts.append(f"States: {states}.\n")
    return "".join(parts).rstrip() + "\n"


def _section(kind: type) -> str:
    tag = kind.__struct_config__.tag  # type: ignore[attr-defined]
    name = f"`{tag}`" if tag else kind.__name__
    lines = [f"### {name}\n", inspect.cleandoc(kind.__doc__ or "").replace("\n", " "), ""]
    fields = msgspec.structs.fields(kind)
    if fields:
        lines += ["| field | type | |", "|---|---|---|"]
        docstrings, hints = _field_docstrings(kind), get_type_hints(kind)
        for field in fields:
            need = "" if field.required else _default(field.default, field.default_factory)
            lines.append(f"| `{field.name}` | {_type(hints[field.name])}{need} | {docstrings.get(field.name, '')} |")
        lines.append("")
    return "\n".join(lines) + "\n"


def _default(default: Any, factory: Any) -> str:
    if default is msgspec.UNSET or (default is msgspec.NODEFAULT and factory is not msgspec.NODEFAULT):
        return ", may be left out"
    if default is None:
        return ""
    return f", {msgspec.json.encode(default).decode()} where left out"


def _type(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        names = [_type(kind) for kind in inner if kind is not type(None)]
        return " or ".join([*names, *(["null"] if type(None) in inner else [])])
    if origin is Literal:
        return " or ".join(f'"{word}"' for word in inner)
    if origin is list:
        return f"list of {_type(inner[0])}"
    if origin is dict:
        return f"object of {_type(inner[1])} by name" if inner[1] is not Any else "object"
    if origin is tuple:
        return f"{len(inner)} numbers"
    if isinstance(hint, type) and issubclass(hint, msgspec.Struct):
        tag = hint.__struct_config__.tag
        return f"`{tag}`" if tag else hint.__name__
    return {float: "number", int: "whole number", str: "text", bool: "true or false"}.get(hint, "anything")


def _layout(title: str, layout: np.dtype[Any], text: str, begin: int) -> str:
    lines = [
        f"### {title}\n",
        f"{layout.itemsize} bytes. {_plain(text)}\n",
        "| offset | type | field |",
        "|---|---|---|",
    ]
    for name in layout.names or ():
        kind, offset = layout.fields[name][:2]  # type: ignore[index]
        base, shape = (kind.subdtype or (kind, ()))[:2]
        times = f"{shape[0]} x " if shape else ""
        lines.append(f"| {begin + offset} | {times}{base.str.lstrip('<|')} | {name} |")
    return "\n".join(lines) + "\n\n"


def _with_kinds(text: str) -> str:
    kinds = {"POSE": pose_wire.POSE, "POSES": pose_wire.POSES}
    return re.sub(r"(?i)\b(kind) (POSES?)\b", lambda found: f"{found[1]} {kinds[found[2]]}", text)


def _plain(text: str) -> str:
    return " ".join(text.split())


def _field_docstrings(kind: type) -> dict[str, str]:
    body = ast.parse(inspect.getsource(kind)).body[0]
    return {name: _plain(text) for name, text in _docstrings(ast.iter_child_nodes(body))}


def _described_constants() -> dict[str, str]:
    return dict(_docstrings(ast.iter_child_nodes(ast.parse(inspect.getsource(pose_wire)))))


def _docstrings(nodes: Iterator[ast.AST]) -> Iterator[tuple[str, str]]:
    """Names that are assigned or declared, and the string below each."""
    for statement, following in pairwise(nodes):
        match statement, following:
            case (
                (ast.AnnAssign(target=ast.Name(id=name)) | ast.Assign(targets=[ast.Name(id=name)])),
                ast.Expr(value=ast.Constant(value=str(text))),
            ):
                yield name, text


if __name__ == "__main__":
    sys.exit(main())
