"""Message types of ROS: those that a file says, and those of ROS itself where it says none. Needs the extra `ros`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from synchronizar.convert.fields import Field
from synchronizar.errors import InputError, os_faults

_DEEPEST = 5
_INTEGERS = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)} | {"byte", "char"}
_FLOATS = {"float32", "float64"}


def short_type(name: str) -> str:
    """package/Name of package/msg/Name."""
    return name.replace("/msg/", "/")


def store_of(definitions: Iterable[tuple[str, str, str]], ros: int, folders: Iterable[Path] = ()) -> Any:
    """A typestore of what ROS 1 or 2 has, what a file says (type, msg or idl, text), and .msg files in folders.

    What the file says goes before what ROS has. A definition that cannot be read is left out: its type is not known.
    """
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    from rosbags.typesys.base import TypesysError

    known = dict(get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE).fielddefs)
    for folder in folders:
        known |= _types_in(folder)
    for name, kind, text in definitions:
        try:
            if kind == "msg":
                known |= get_types_from_msg(text, name)
            else:
                for part in _idl_parts(text):
                    known |= get_types_from_idl(part)
        except TypesysError:
            continue
    store = get_typestore(Stores.EMPTY)
    store.register(known)
    return store


def _idl_parts(text: str) -> list[str]:
    """The types in an IDL text, which stand below lines of = and their names."""
    line = "=" * 80 + "\n"
    if not text.startswith(f"{line}IDL: "):
        return [text]
    return [part.split("\n", 1)[-1] for part in text.split(line)[1:]]


def _types_in(folder: Path) -> dict[str, Any]:
    from rosbags.typesys import get_types_from_msg
    from rosbags.typesys.base import TypesysError

    found: dict[str, Any] = {}
    with os_faults(folder):
        files = sorted(folder.rglob("*.msg"))
    if not files:
        raise InputError(folder, "holds no .msg file: name a folder like uwb_msgs/msg/Range.msg")
    for file in files:
        package = file.parent.parent.name if file.parent.name == "msg" else file.parent.name
        with os_faults(file):
            text = file.read_text(encoding="utf-8", errors="replace")
        try:
            found |= get_types_from_msg(text, f"{package}/msg/{file.stem}")
        except TypesysError as error:
            raise InputError(file, f"is no message definition: {error}") from error
    return found


def fields_of(store: Any, name: str) -> tuple[Field, ...]:
    """All fields of a message type; none where it is not known."""
    return tuple(_fields(store, name, "", _DEEPEST))


def _fields(store: Any, name: str, path: str, depth: int) -> Iterator[Field]:
    from rosbags.interfaces import Nodetype

    if name not in store.fielddefs or not depth:
        return
    for part, (node, of) in store.fielddefs[name][1]:
        if node in (Nodetype.BASE, Nodetype.NAME):
            yield from _field(store, node == Nodetype.BASE, of, f"{path}{part}", depth)
        elif "[]" not in path:
            inner, item = of[0]
            yield from _field(store, inner == Nodetype.BASE, item, f"{path}{part}[]", depth)


def _field(store: Any, is_base: bool, of: Any, path: str, depth: int) -> Iterator[Field]:
    if not is_base:
        yield from _fields(store, of, f"{path}.", depth - 1)
        return
    base = of[0]
    kinds = {"string": "text", "wstring": "text", "bool": "truth"}
    yield Field(path, "integer" if base in _INTEGERS else "float" if base in _FLOATS else kinds.get(base, "other"))
