"""Imports run one way: a folder imports from those in its row, and from whatever those may import from."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from itertools import chain
from pathlib import Path

import pytest
from support.paths import REPOSITORY

PACKAGE = REPOSITORY / "synchronizar"

# A folder, and the folders right below it. `base` are the files of the package itself, `face` those above all.
ALLOWED = {
    "base": (),
    "data": ("base",),
    "io": ("data",),
    "convert": ("io",),
    "preprocessing": ("data",),
    "diagnosis": ("preprocessing",),
    "graph": ("preprocessing",),
    "estimation": ("graph", "diagnosis"),
    "simulation": ("io",),
    "reporting": ("io", "estimation"),
    "live": ("io", "estimation"),
    "ros": ("live", "convert"),
    "apps": ("ros",),
    "cli": ("reporting", "simulation", "ros"),
    "face": ("cli",),
}
FACE = ("__init__", "__main__")
# `Recording.load` and `save` are what users look for; reading and writing themselves are io's.
EXCEPTIONS = {("data/recording.py", "io")}

ALONE_WITH = {"gtsam": ("graph",), "matplotlib": ("reporting",), "scipy": ("estimation",)}


def folder_of(file: Path) -> str:
    parts = file.relative_to(PACKAGE).parts
    if len(parts) > 1:
        return parts[0]
    return "face" if file.stem in FACE else "base"


FILES = sorted(chain(PACKAGE.rglob("*.py"), PACKAGE.rglob("*.pyi")))


def imports(source: str, package: tuple[str, ...]) -> Iterator[str]:
    """Full names of everything that the source of a file in `package` imports, wherever in the file it does."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def imports_of(file: Path) -> set[str]:
    return set(imports(file.read_text(), ("synchronizar", *file.relative_to(PACKAGE).parts[:-1])))


def folder_named(name: str) -> str | None:
    """The folder that an imported name `synchronizar.a.b` is in; None for names from elsewhere."""
    root, *parts = name.split(".")
    if root != "synchronizar":
        return None
    if parts and (PACKAGE / parts[0]).is_dir():
        return parts[0]
    return "base" if parts and parts[0] not in FACE and list(PACKAGE.glob(f"{parts[0]}.py*")) else "face"


@cache
def below(folder: str) -> frozenset[str]:
    """A folder, and all that it may import from."""
    return frozenset({folder}).union(*(below(lower) for lower in ALLOWED[folder]))


def test_every_folder_has_a_row() -> None:
    assert {folder_of(file) for file in FILES} == set(ALLOWED)


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.relative_to(PACKAGE)))
def test_a_file_imports_from_its_own_folder_and_those_below_it(file: Path) -> None:
    folder, name = folder_of(file), str(file.relative_to(PACKAGE))
    others = {folder_named(name) for name in imports_of(file)} - {None} - below(folder)
    assert not {other for other in others if (name, other) not in EXCEPTIONS}


def test_no_exception_is_without_use() -> None:
    for name, other in EXCEPTIONS:
        assert other in {folder_named(imported) for imported in imports_of(PACKAGE / name)}


@pytest.mark.parametrize("library", ALONE_WITH)
def test_a_heavy_library_stays_in_its_folder(library: str) -> None:
    users = {folder_of(f) for f in FILES if any(name.split(".")[0] == library for name in imports_of(f))}
    assert users <= set(ALONE_WITH[library])


def test_no_two_files_import_each_other() -> None:
    module = {".".join(("synchronizar", *f.relative_to(PACKAGE).with_suffix("").parts)): f for f in FILES}
    uses = {
        name: {n for imported in imports_of(file) for n in (imported, imported.rpartition(".")[0]) if n in module}
        for name, file in module.items()
    }
    for name, folder in EXCEPTIONS:
        module_name = ".".join(("synchronizar", *Path(name).with_suffix("").parts))
        uses[module_name] = {used for used in uses[module_name] if used.split(".")[1] != folder}
    while free := {name for name, used in uses.items() if not used & uses.keys() - {name}}:
        uses = {name: used for name, used in uses.items() if name not in free}
    assert not uses


@pytest.mark.parametrize("module", ["synchronizar", "synchronizar.cli"])
def test_starting_is_light(module: str) -> None:
    heavy = {*ALONE_WITH, "numpy"}
    code = f"import sys, {module}; print(*(sys.modules.keys() & {heavy!r}))"
    run = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_imports_are_found_in_every_form() -> None:
    source = """
import numpy as np
from synchronizar import geometry
from synchronizar.io import tum
def later():
    import gtsam.noiseModel
    from .text import quoted
    from ..data.track import Track
"""
    assert set(imports(source, ("synchronizar", "io"))) == {
        "numpy",
        "synchronizar.geometry",
        "synchronizar.io.tum",
        "gtsam.noiseModel",
        "synchronizar.io.text.quoted",
        "synchronizar.data.track.Track",
    }
    assert folder_named("synchronizar.io.tum.read_tum") == "io"
    assert folder_named("synchronizar.geometry") == "base"
    assert folder_named("synchronizar._core.mixture_terms") == "base"
    assert folder_named("synchronizar.cli.main") == "cli"
    assert folder_named("synchronizar.State") == "face"
    assert folder_named("numpy.linalg") is None
