"""Every real recording under a folder: what the rigid model makes of it.

`python -m experiments.recordings ../shared/recordings`: registers each, compares it with its truth, and prints a table.
SLAM whose scale drifts, clocks and radio biases are not in the rigid model: where a recording has them, it shows here.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path
from time import perf_counter
from typing import Any

from experiments.results import write_table
from synchronizar import report
from synchronizar.evaluate import evaluate_folder
from synchronizar.pipeline import register
from synchronizar.recording import Recording


def row_of(folder: Path) -> dict[str, Any]:
    """What becomes of one recording."""
    began = perf_counter()
    recording = Recording.load(folder)
    registration = register(recording, kind="rigid")
    seconds = perf_counter() - began
    with tempfile.TemporaryDirectory() as out:
        report.write(registration, recording, out)
        evaluation = evaluate_folder(folder, Path(out))
    transfer = [x for x in evaluation.transfer_xy.values() if x is not None]
    states = [str(user.state) for name, user in registration.users.items() if name != registration.reference]
    return {
        "recording": folder.name,
        "users": len(recording.users),
        "joint ate": evaluation.joint_ate,
        "joint ate xy": evaluation.joint_ate_xy,
        "worst transfer xy": max(transfer, default=None),
        **report.range_counts(registration.ranges),
        "states": " ".join(f"{states.count(s)} {s}" for s in sorted(set(states))),
        "seconds": seconds,
    }


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    folders = sorted(f.parent for f in options.folder.glob("*/ranges.csv"))
    print(write_table("recordings", [row_of(folder) for folder in folders], {"folder": str(options.folder)}))


if __name__ == "__main__":
    main()
