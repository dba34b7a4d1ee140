from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "synchronizar"

# Lowest first. A file imports from floors below its own, never from its own or from above.
FLOORS = (
    {"errors", "arrays"},
    {"geometry"},
    {"track", "ranges", "user", "pairwise_solve"},
    {"formats", "formats.text"},
    {"formats.tum", "formats.ranges_csv"},
    {"formats.recording_toml"},
    {"recording"},
    {"scene"},
    {"walkers", "radios"},
    {"simulate"},
    {"model"},
    {"jumps"},
    {"samples"},
    {"centre", "corners", "keyframes", "worth"},
    {"walks"},
    {"registration", "portions"},
    {"_core", "keys"},
    {"factors", "carried"},
    {"graph", "optimize"},
    {"initialise"},
    {"mirrors", "misfit", "placement"},
    {"batch", "verdict", "anchored"},
    {"outcome", "slips", "sureness", "step_noise"},
    {"settled"},
    {"rigid", "spans", "told", "cues"},
    {"full"},
    {"pipeline", "stream"},
    {"memory", "pairwise"},
    {"window", "solution"},
    {"incremental"},
    {"replay"},
    {"__init__"},
    {"report", "evaluate"},
    {"live", "live.wire", "live.range_clock", "live.scenario"},
    {"live.receiver", "live.air"},
    {"live.collect"},
    {"modules"},
    {"plots.answer"},
    {"plots.drift", "plots.uncertainty", "plots.updates"},
    {"plots.style"},
    {"plots.walks", "plots.residuals", "plots.corrections", "plots.estimates", "plots.jump_list"},
    {"plots.pairs"},
    {"plots.picture", "plots.devices", "plots.timeline"},
    {"plots.files"},
    {"plots"},
    {"cli"},
    {"__main__"},
)
FLOOR_OF = {name: floor for floor, names in enumerate(FLOORS) for name in names}

ALONE_WITH = {
    "matplotlib": {
        *("plots.walks", "plots.residuals", "plots.corrections", "plots.estimates", "plots.jump_list", "plots.pairs"),
        *("plots.picture", "plots.devices", "plots.timeline", "plots.files"),
    },
    "scipy": {"pairwise_solve"},
    "gtsam": {"factors", "graph", "batch", "optimize", "keys", "carried", "anchored", "step_noise"},
}


def module_of(file: Path) -> str:
    """`formats.tum`, `formats` of its `__init__.py`, `__init__` of the package's own."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if len(parts) > 1 and parts[-1] == "__init__" else parts)


MODULES = {module_of(file): file for file in chain(PACKAGE.rglob("*.py"), PACKAGE.rglob("*.pyi"))}


def imports(source: str, package: tuple[str, ...]) -> Iterator[str]:
    """Full names of everything that the source of a file in `package` imports, wherever in the file it does."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join([*above, *([node.module] if node.module else [])])
            yield from (f"{base}.{alias.name}" for alias in node.names)


def imports_of(module: str) -> set[str]:
    file = MODULES[module]
    return set(imports(file.read_text(), ("synchronizar", *file.relative_to(PACKAGE).parts[:-1])))


def own_module(name: str) -> str | None:
    """The file that an imported name `synchronizar.a.b` is in; None for names from elsewhere."""
    root, *parts = name.split(".")
    if root != "synchronizar":
        return None
    candidates = (".".join(parts[:n]) for n in range(len(parts), 0, -1))
    return next((c for c in candidates if c in MODULES or c in FLOOR_OF), "__init__")


def test_every_file_has_a_floor() -> None:
    homeless = sorted(set(MODULES) - set(FLOOR_OF))
    assert not homeless, (
        f"give {', '.join(homeless)} a floor in FLOORS in tests/test_layers.py: above all that it imports"
    )


@pytest.mark.parametrize("module", sorted(set(MODULES) & set(FLOOR_OF)))
def test_a_file_imports_from_the_floors_below_it_alone(module: str) -> None:
    own = {own_module(name) for name in imports_of(module)} - {None}
    upwards = sorted(other for other in own if FLOOR_OF.get(other, len(FLOORS)) >= FLOOR_OF[module])
    assert not upwards, f"{module} imports {', '.join(upwards)}, not below it"


@pytest.mark.parametrize("library", ALONE_WITH)
def test_a_heavy_library_stays_where_it_belongs(library: str) -> None:
    users = {module for module in MODULES if any(name.split(".")[0] == library for name in imports_of(module))}
    assert users <= ALONE_WITH[library]


@pytest.mark.parametrize("module", ["synchronizar", "synchronizar.cli"])
def test_starting_is_light(module: str) -> None:
    if module == "synchronizar.cli" and "cli" not in MODULES:
        pytest.skip("there is no command line yet")
    code = f"import sys, {module}; print(*(sys.modules.keys() & {set(ALONE_WITH)!r}))"
    run = subprocess.run([sys.executable, "-c", code], cwd=PACKAGE.parent, capture_output=True, text=True, check=True)
    assert run.stdout.split() == []


def test_imports_are_found_in_every_form() -> None:
    source = """
import numpy as np
from synchronizar import geometry
from synchronizar.formats import tum
def late():
    import gtsam.noiseModel
    from .errors import InputError
    from ..track import Track
"""
    found = set(imports(source, ("synchronizar", "formats")))
    assert found == {
        "numpy",
        "synchronizar.geometry",
        "synchronizar.formats.tum",
        "gtsam.noiseModel",
        "synchronizar.formats.errors.InputError",
        "synchronizar.track.Track",
    }
    assert own_module("synchronizar.formats.tum.read_tum") == "formats.tum"
    assert own_module("synchronizar.geometry") == "geometry"
    assert own_module("synchronizar.pipeline") == "pipeline"
    assert own_module("synchronizar.State") == "__init__"
    assert own_module("numpy.linalg") is None
