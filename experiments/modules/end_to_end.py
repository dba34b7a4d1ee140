"""The whole chain: modules of three walkers range in the simulated air; receiver, registration, evaluation.

`python -m experiments.modules.end_to_end [--walks 4]`: the same walks of 12 s (ranges good to 0.03 m, one in ten late)
with each scheme, the paper's own rate (polling) among them. How soon somebody is registered counts from when modules
are switched on. The first walk is drawn: what is on air for 20 ms, and how wrong ranges are.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.common.markdown import markdown
from experiments.common.results import write_table
from experiments.common.study import figure, rms
from experiments.common.walks import on_all_cores
from synchronizar.data.registration import State
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.register import register
from synchronizar.reporting.evaluate import evaluate
from synchronizar.simulation.air import Frame
from synchronizar.simulation.modules import simulate_modules
from synchronizar.simulation.scene import SCHEMES, Scene
from synchronizar.simulation.simulate import Simulation

SCENE = Scene(users=3, seconds=12.0, sigma=0.03, late_share=0.1)
OFF_M = 0.6
"""What is farther off is wrong."""
PICTURE = Path(__file__).parents[1] / "figures" / "modules.png"
SHOWN_S = (6.0, 6.02)
ROLES = {"poll": "#332288", "answer": "#44AA99", "final": "#CC6677"}
SIGHT = {"line of sight": "#332288", "without it": "#CC6677"}


class Task(NamedTuple):
    """One walk."""

    scheme: str
    seed: int


class Found(NamedTuple):
    """What came of one walk, of its users but the reference."""

    hz: float
    """Ranges a second, of each pair that ranges."""
    states: list[State]
    off_xy: list[float]
    """m, RMSE in the plane over the walk, beside the reference."""
    yaw: list[float]
    """rad."""
    first: list[float]
    """s after the modules are switched on, when registered; infinity for never."""


def walk(task: Task) -> Found:
    """Registered at once, and as it would have come."""
    simulation = simulate_modules(replace(SCENE, seed=task.seed), task.scheme).simulation
    recording = simulation.recording
    registration = register(recording)
    evaluation = evaluate(registration.tracks(recording), simulation.truth, registration.reference)
    others = [name for name in registration.users if name != registration.reference]
    updates = replay(recording, registration.reference).updates
    registered = [[u.t for u in updates if u.users[name].state is State.REGISTERED] for name in others]
    t = recording.ranges.t
    pairs = len(np.unique(np.sort(np.column_stack([recording.ranges.a, recording.ranges.b]), axis=1), axis=0))
    return Found(
        hz=len(t) / (t[-1] - t[0]) / pairs,
        states=[registration.users[name].state for name in others],
        off_xy=[_known(evaluation.transfer_xy[name]) for name in others],
        yaw=[_known(evaluation.yaw[name]) for name in others],
        first=[moments[0] if moments else np.inf for moments in registered],
    )


def _known(figure: float | None) -> float:
    return np.nan if figure is None else figure


def row_of(scheme: str, walks: list[Found]) -> dict[str, Any]:
    """A line of the table."""
    off, first = np.concatenate([w.off_xy for w in walks]), np.concatenate([w.first for w in walks])
    registered = np.array([state is State.REGISTERED for w in walks for state in w.states])
    return {
        "scheme": scheme,
        "Hz": float(np.mean([w.hz for w in walks])),
        "registered": f"{registered.sum()} of {len(registered)}",
        "of these off > 0.6 m": int((off[registered] > OFF_M).sum()),
        "rms xy, m": rms(off),
        "largest xy, m": float(off.max()),
        "rms yaw, rad": rms(np.concatenate([w.yaw for w in walks])),
        "ever registered in 12 s": f"{np.isfinite(first).sum()} of {len(first)}",
        "median s until then": float(np.median(first)) if np.isfinite(np.median(first)) else None,
    }


def draw() -> None:
    """The picture of one walk, and what it shows in words."""
    heard = simulate_modules(SCENE, SCHEMES[0], frames=True)
    made, axes = figure(rows=2, height=1.9)
    _draw_frames(axes[0, 0], heard.frames)
    _draw_errors(axes[1, 0], heard.simulation)
    PICTURE.parent.mkdir(exist_ok=True)
    made.savefig(PICTURE, dpi=200)
    print(PICTURE)


def _draw_frames(ax: Axes, frames: list[Frame]) -> None:
    begin, end = SHOWN_S
    shown = [f for f in frames if begin <= f.begin < end]
    coordinator = next(f.sender for f in shown if f.slot == 0)
    for role, colour in ROLES.items():
        mine = [f for f in shown if _role(f, coordinator) == role]
        left = 1e3 * np.array([f.begin - begin for f in mine])
        width = 1e3 * np.array([f.end - f.begin for f in mine])
        ax.barh([f.sender for f in mine], width, left=left, height=0.7, color=colour, label=role)
    ax.set_yticks(range(SCENE.users), [f"module {i}" for i in range(SCENE.users)])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 1e3 * (end - begin))
    ax.set_xlabel(f"ms after {begin:g} s")
    ax.set_title("On air: one to n, a round of n + 2 slots of 1 ms", loc="left")
    ax.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0), frameon=False)


def _role(frame: Frame, coordinator: int) -> str:
    if frame.sender != coordinator:
        return "answer"
    return "poll" if frame.slot == 0 else "final"


def _draw_errors(ax: Axes, simulation: Simulation) -> None:
    error, late, nlos = simulation.range_errors(), simulation.late, simulation.recording.ranges.nlos
    bins = np.arange(-0.2, min(3.0, float(error.max())) + 0.02, 0.02)
    for (sight, colour), mine in zip(SIGHT.items(), (~late, late), strict=True):
        off = 100.0 * (error[mine] - simulation.extra[mine])
        label = f"{sight}: {mine.sum()}, beside what the air put in {off.mean():+.1f} cm, sd {off.std():.1f} cm"
        ax.hist(error[mine], bins, color=colour, alpha=0.8, label=label)
    blocked, clear = nlos == 1.0, nlos == 0.0
    hints = (
        f"in line of sight clear {clear[~late].mean():.1%}, blocked {blocked[~late].mean():.1%}; "
        f"without it clear {clear[late].mean():.1%}, blocked {blocked[late].mean():.1%}"
    )
    ax.set_yscale("log")
    ax.set_xlabel("measured minus true distance, m")
    ax.set_ylabel("ranges")
    ax.set_title(f"Errors of ranges. What the modules themselves take signals for:\n{hints}", loc="left")
    ax.legend(loc="upper right", frameon=False)


def main() -> None:
    """The picture, and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--walks", type=int, default=4)
    options = parser.parse_args()
    draw()
    tasks = [Task(scheme, seed) for scheme in SCHEMES for seed in range(options.walks)]
    results = list(on_all_cores(walk, tasks))
    rows = [
        row_of(scheme, [found for task, found in zip(tasks, results, strict=True) if task.scheme == scheme])
        for scheme in SCHEMES
    ]
    write_table("modules", rows, vars(options))
    print(markdown(rows))


if __name__ == "__main__":
    main()
