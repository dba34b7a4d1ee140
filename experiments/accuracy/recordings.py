"""Accuracy of either model on every real recording in a folder.

`python -m experiments.accuracy.recordings ../shared/recordings [--model rigid]`: registers each, compares it with its
truth, and prints a table.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any, Literal

from experiments.common.results import write_table
from synchronizar.data.recording import Recording
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import range_counts, write_registration
from synchronizar.reporting.evaluate import evaluate_folder


def row_of(folder: Path, kind: Literal["full", "rigid"]) -> dict[str, Any]:
    """What becomes of one recording."""
    began = perf_counter()
    recording = Recording.load(folder)
    registration = register(recording, model=kind)
    seconds = perf_counter() - began
    with tempfile.TemporaryDirectory() as out:
        write_registration(registration, recording, out)
        evaluation = evaluate_folder(folder, Path(out))
    transfer = [x for x in evaluation.transfer_xy.values() if x is not None]
    states = [str(user.state) for name, user in registration.users.items() if name != registration.reference]
    return {
        "recording": folder.name,
        "users": len(recording.users),
        "joint ate": evaluation.joint_ate,
        "joint ate xy": evaluation.joint_ate_xy,
        "worst transfer xy": max(transfer, default=None),
        **range_counts(registration.ranges),
        "states": " ".join(f"{states.count(s)} {s}" for s in sorted(set(states))),
        "seconds": seconds,
    }


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--model", choices=["full", "rigid"], default="full")
    options = parser.parse_args()
    folders = sorted(f.parent for f in options.folder.glob("*/ranges.csv"))
    rows = [row_of(folder, options.model) for folder in folders]
    print(write_table(f"recordings_{options.model}", rows, {"folder": str(options.folder), "model": options.model}))


if __name__ == "__main__":
    main()
