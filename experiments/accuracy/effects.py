"""Ablation on real recordings: accuracy with each effect of the model switched off in turn.

`python -m experiments.accuracy.effects ../shared/recordings [--only vub_exp2 ...]`: registers every recording with the
default model, with one effect after the other taken out by numbers of the model, and as rigid frames. Prints a table in
markdown with each recording's figure (m), and writes all figures to experiments/results/.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any, Literal, NamedTuple

from experiments.common.results import write_table
from experiments.common.walks import on_all_cores
from synchronizar.data.recording import Recording
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import write_registration
from synchronizar.parameters import Parameters
from synchronizar.reporting.evaluate import evaluate_folder

_NONE = 1e-5  # a sigma that is as good as none
_STIFF = 1e-4  # per root metre or second: a centimetre in an hour; less makes steps too stiff for the solver

OFF: dict[str, dict[str, dict[str, float]]] = {
    "everything on": {},
    "drift off": {
        "slam": {
            "drift_m_per_sqrt_s": _STIFF,
            "drift_m_per_sqrt_m": _STIFF,
            "drift_rad_per_sqrt_s": _STIFF,
            "drift_rad_per_sqrt_m": _STIFF,
        }
    },
    "scale off": {"devices": {"scale_sigma": _NONE, "scale_common_sigma": _NONE}},
    "bias off": {"devices": {"bias_sigma": _NONE, "bias_common_sigma": _NONE}},
    "clocks off": {"devices": {"clock_sigma": _NONE, "clock_common_sigma": _NONE}},
    "jumps not mended": {"slam": {"jump_least": 1e3, "jump_turn": 1e3}},
    "late signals off": {
        "ranges": {
            "nlos_share": 1e-6,
            "nlos_share_clear": 1e-6,
            "nlos_share_blocked": 1e-6,
            "short_share": 1e-9,
        }
    },
    "errors taken for independent": {"ranges": {"multipath_correlation": 0.0, "multipath_weight": 1e12}},
}
RIGID = "rigid frames"
FIGURE = {"vub": "transfer xy", "tiers": "joint ate xy"}
"""By how a recording's name begins: planar ones are judged in the plane, others in space."""


def figure_of(recording: str) -> str:
    """Which of a row's columns the recording is judged by."""
    return next((figure for begins, figure in FIGURE.items() if recording.startswith(begins)), "joint ate")


class Task(NamedTuple):
    """One recording with one effect switched off."""

    effect: str
    folder: Path


def row_of(task: Task) -> dict[str, Any]:
    """Its figures."""
    effect, folder = task
    recording = Recording.load(folder)
    kind: Literal["full", "rigid"] = "rigid" if effect == RIGID else "full"
    began = perf_counter()
    registration = register(recording, parameters=Parameters().changed(**OFF.get(effect, {})), model=kind)
    seconds = perf_counter() - began
    with tempfile.TemporaryDirectory() as out:
        write_registration(registration, recording, out)
        evaluation = evaluate_folder(folder, Path(out))
    transfer = [x for x in evaluation.transfer_xy.values() if x is not None]
    states = [str(user.state) for name, user in registration.users.items() if name != registration.reference]
    return {
        "effect": effect,
        "recording": folder.name,
        "joint ate": evaluation.joint_ate,
        "joint ate xy": evaluation.joint_ate_xy,
        "transfer xy": max(transfer, default=None),
        "states": " ".join(f"{states.count(s)} {s}" for s in sorted(set(states))),
        "seconds": seconds,
    }


def markdown(rows: list[dict[str, Any]]) -> str:
    """A row for each effect, a column for each recording."""
    recordings = sorted({row["recording"] for row in rows})
    figures = {(row["effect"], row["recording"]): row[figure_of(row["recording"])] for row in rows}
    lines = [
        "| | " + " | ".join(f"{name}, {figure_of(name)}" for name in recordings) + " |",
        "|---|" + "---|" * len(recordings),
    ]
    for effect in (*OFF, RIGID):
        cells = [_cell(figures[effect, name]) for name in recordings]
        lines.append(f"| {effect} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _cell(figure: float | None) -> str:
    return "-" if figure is None else f"{figure:.3f}"


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", nargs="+", help="names of recordings")
    options = parser.parse_args()
    folders = sorted(f.parent for f in options.folder.glob("*/ranges.csv"))
    folders = [f for f in folders if options.only is None or f.name in options.only]
    rows = list(on_all_cores(row_of, [Task(effect, folder) for effect in (*OFF, RIGID) for folder in folders]))
    print(write_table("effects", rows, {"folder": str(options.folder), "only": options.only}))
    print()
    print(markdown(rows))


if __name__ == "__main__":
    main()
