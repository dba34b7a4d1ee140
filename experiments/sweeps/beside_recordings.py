"""Beyond the paper: errors of its method and of ours on real recordings with a truth.

`python -m experiments.sweeps.beside_recordings [--recordings FOLDER] [--scheduler ADDRESS]`: each recording once.
A table and a figure beyond_recordings; nothing where there is no recording with truth.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from experiments.common.methods import METHODS
from experiments.common.study import COLOURS, MARKERS, figure, results_of, save
from synchronizar.data.recording import Recording
from synchronizar.reporting.evaluate import evaluate, read_tracks

HERE = Path("../shared/recordings")


class Task(NamedTuple):
    """One recording by one method."""

    folder: Path
    method: str


def row_of(task: Task) -> dict[str, Any]:
    """What becomes of it; seconds are CPU time of the process, all threads together."""
    recording = Recording.load(task.folder)
    began = process_time()
    registration = METHODS[task.method](recording)
    seconds = process_time() - began
    evaluation = evaluate(registration.tracks(recording), read_tracks(task.folder / "truth"), registration.reference)
    transfer = [error for error in evaluation.transfer_xy.values() if error is not None]
    states = [str(user.state) for name, user in registration.users.items() if name != registration.reference]
    return {
        "recording": task.folder.name,
        "users": len(recording.users),
        "method": task.method,
        "joint ate": evaluation.joint_ate,
        "joint ate xy": evaluation.joint_ate_xy,
        "worst transfer xy": max(transfer, default=None),
        "missing": len(evaluation.missing),
        "states": " ".join(f"{states.count(s)} {s}" for s in sorted(set(states))),
        "seconds": seconds,
    }


def main(argv: Sequence[str] | None = None) -> None:
    """The table and the figure."""
    options, began = _options(argv), perf_counter()
    folders = sorted(f.parent for f in Path(options.recordings).glob("*/ranges.csv") if (f.parent / "truth").is_dir())
    if not folders:
        print(f"{options.recordings} holds no recordings with truth: skipped")
        return
    rows = results_of(row_of, [Task(folder, method) for folder in folders for method in METHODS], options)
    save("beyond_recordings", rows, drawn(rows), options, began)


def drawn(rows: Sequence[dict[str, Any]]) -> Figure:
    """Errors and times of each recording; a transfer that the truth cannot tell is left out."""
    made, axes = figure(columns=3, height=3.2)
    names = list(dict.fromkeys(row["recording"] for row in rows))
    labels = {
        "joint ate xy": "RMSE, all aligned together (m)",
        "worst transfer xy": "worst RMSE, reference aligned (m)",
        "seconds": "CPU time (s)",
    }
    for ax, (what, label) in zip(axes[0], labels.items(), strict=True):
        for method in METHODS:
            value = [np.nan if row[what] is None else row[what] for row in rows if row["method"] == method]
            ax.plot(value, range(len(names)), MARKERS[method], color=COLOURS[method], markersize=5, label=method)
        ax.set(xscale="log", xlabel=label, ylim=(len(names) - 0.5, -0.5))
        ax.set_yticks(range(len(names)), names if ax is axes[0, 0] else [])
    handles, methods = axes[0, 0].get_legend_handles_labels()
    made.legend(handles, methods, loc="outside upper center", ncols=len(methods), frameon=False)
    return made


def _options(argv: Sequence[str] | None) -> argparse.Namespace:
    """Not those of every study: there is nothing at random here and no smaller size, what there is being registered."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", metavar="FOLDER", default=str(HERE), help=f"with recordings (default: {HERE})")
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that does the tasks")
    parser.set_defaults(full=False)
    return parser.parse_args(argv)


if __name__ == "__main__":
    main()
