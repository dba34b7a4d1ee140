"""View pointing, figure 9 of SynchronizAR (Huo et al., UIST 2018): a user points at spheres that the partner sees.

`python -m experiments.paper.pointing [--full] [--seed N] [--scheduler ADDRESS]`

11 users make 3 trials of 4 pointings each; --full makes 20 times as many trials. Each trial begins with a registration
of its own: two people walk (synchronizar.simulate, ranges of 0.1 m, SLAM without drift) for 10.1 s, which at 9.9 Hz are
the paper's 100 samples. The partner's spheres are shown to the user through three estimates from the same walk:
`pairwise` (the paper's method), `rigid` (ours with SLAM trusted, the paper's model) and `joint` (ours as it comes).
Nobody is left out, however unsure ours says it is. The angle is that between where the user points and where the sphere
truly is, seen from the user's device. A pointing is at the wrong sphere where another of the 8 is nearer in angle.

Assumed, the paper's being unknown here:
- 8 spheres stand evenly on a circle of 1 m about the chair, 1.0 m above the floor; the chair is in the middle of the
  room of 6 x 6 m in which both walked before;
- the user stands 2 m from the chair on a bearing at random, the device 1.4 m above the floor, and looks between two
  spheres; seen from there, they are 9 deg apart or more;
- the 4 spheres of a trial are different ones, drawn at random.

Human noise: Microsoft's guideline "Head-gaze and commit" (HoloLens) finds targets of 1 to 1.5 deg to be hit in most
scenarios. That 1.5 deg is taken for the effective target width of ISO 9241-9, which is 4.133 sd wide (96 % hits;
MacKenzie, Human-Computer Interaction 7, 1992): 0.36 deg, 1 sigma, to the side and up. Reading "most" as 96 % is an
assumption. It tells how well a person aims at what is seen, not how often the wrong thing is aimed at: slips, and
misunderstandings between people, are not simulated.

Trials are independent, the pointings of one trial are not: intervals resample trials, those of shares of trials are
exact (Clopper and Pearson 1934), and the paired test (Wilcoxon's signed ranks, angles being skewed) is of the means of
trials. A figure of the paper's counts as reproduced where the
95 % interval contains it (`yes`) or lies below it (`yes, lower`), else `no`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.common.methods import METHODS, share
from experiments.common.study import (
    COLOURS,
    CONFIDENCE,
    MARKERS,
    RESAMPLED,
    Interval,
    figure,
    interval,
    options_of,
    results_of,
    save,
)
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.registration import Registration
from synchronizar.geometry import YawFrame, rotation_2d
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

PARTNER, USER = "phone0", "phone1"
SAMPLES = 100
"""Ranges of a registration, as in the paper."""
WALK_S = SAMPLES / papers_rate_hz(partners=1)
"""s: in which these come."""
USERS, TRIALS, SEQUENCE = 11, 3, 4
FULL = 20
"""How many times as many trials the full run has."""
PAPER = {"mean": 3.7, "sd": 9.0}
"""deg."""

SPHERES, CIRCLE_M, SPHERE_HEIGHT_M = 8, 1.0, 1.0
STAND_M, VIEW_HEIGHT_M = 2.0, 1.4
AIM_SIGMA = np.radians(1.5 / 4.133)
"""rad, 1 sigma: how a person's aim scatters about what is aimed at, to the side and up."""

STATISTICS: dict[str, Callable[[Array], float]] = {
    "mean": lambda angle: float(np.mean(angle)),
    "sd": lambda angle: float(np.std(angle, ddof=1)),
    "median": lambda angle: float(np.median(angle)),
    "95th percentile": lambda angle: float(np.quantile(angle, 0.95)),
}
AIMS = ("exact", "human")
"""Whether the user aims without error, so that what is left is the registration's, or like a person."""


class Trial(NamedTuple):
    """The pointings of one trial, by method."""

    angle: Array
    """(3, 2, 4) deg, by method and aim: between the pointing and the sphere."""
    wrong: Mask
    """(3, 2, 4) whether another sphere is nearer."""
    shown: Array
    """(3, 8, 2) m: where in the plan the spheres are seen, the chair at 0 and the user at (-2, 0)."""
    registered: Mask
    """(3,) whether the method says that the user is registered."""


def walk_of(*seed: int, seconds: float = WALK_S) -> Simulation:
    """Two people who walk until the paper's number of ranges is there, or longer."""
    scene_seed = int(np.random.SeedSequence(seed).generate_state(1)[0])
    return simulate(Scene(seconds=seconds, seed=scene_seed))


def seen_from_true(walk: Simulation, registration: Registration) -> YawFrame:
    """Where in the room the user sees what the partner has put somewhere in the room; the identity at best."""
    partner_from_room = walk.world_from_user[PARTNER].inverse()
    return walk.world_from_user[USER] @ (registration.between(USER, PARTNER) @ partner_from_room)


def spheres() -> Array:
    """(8, 3) m: around a chair at 0, for a user at (-2, 0) who looks between two of them."""
    bearing = (np.arange(SPHERES) + 0.5) * (2.0 * np.pi / SPHERES)
    plan = CIRCLE_M * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return np.column_stack([plan, np.full(SPHERES, SPHERE_HEIGHT_M)])


def angle_between(a: Array, b: Array) -> Array:
    """(...) rad: between vectors (..., 3), exact for small angles too."""
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def aimed(direction: Array, error: Array) -> Array:
    """Directions (n, 3) turned by errors (n, 2) rad to the side and up."""
    unit = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross([0.0, 0.0, 1.0], unit)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.asarray(unit + np.tan(error[:, :1]) * side + np.tan(error[:, 1:]) * np.cross(unit, side))


def nearest(pointing: Array, candidates: Array) -> Indices:
    """(n,) which of the candidates (m, 3) is nearest in angle to each pointing (n, 3)."""
    return np.asarray(np.argmin(angle_between(pointing[:, None], candidates[None]), axis=1), dtype=np.int32)


def trial(task: tuple[int, int]) -> Trial:
    """One trial: (seed of the study, number of the trial)."""
    walk = walk_of(*task)
    random = np.random.default_rng(task)
    # The setting stands at any bearing in the room.
    room_from_setting = YawFrame(yaw=float(random.uniform(-np.pi, np.pi)))
    target = random.choice(SPHERES, SEQUENCE, replace=False)
    error = AIM_SIGMA * random.standard_normal((SEQUENCE, 2))
    view = np.array([-STAND_M, 0.0, VIEW_HEIGHT_M])
    true = spheres() - view
    angle, wrong = np.empty((len(METHODS), len(AIMS), SEQUENCE)), np.empty((len(METHODS), len(AIMS), SEQUENCE), bool)
    shown, registered = np.empty((len(METHODS), SPHERES, 2)), np.empty(len(METHODS), bool)
    for m, method in enumerate(METHODS.values()):
        registration = method(walk.recording)
        seen = room_from_setting.inverse() @ (seen_from_true(walk, registration) @ (room_from_setting @ spheres()))
        shown[m], registered[m] = seen[:, :2], registration.users[USER].state == "registered"
        for a, scatter in enumerate((np.zeros_like(error), error)):
            pointing = aimed((seen - view)[target], scatter)
            angle[m, a] = np.degrees(angle_between(pointing, true[target]))
            wrong[m, a] = nearest(pointing, true) != target
    return Trial(angle, wrong, shown, registered)


def table(trials: Sequence[Trial]) -> list[dict[str, Any]]:
    """A row for each statistic of each method and aim."""
    angle, wrong = np.array([t.angle for t in trials]), np.array([t.wrong for t in trials])
    rows = []
    for a, aim in enumerate(AIMS):
        for m, method in enumerate(METHODS):
            for name, statistic in STATISTICS.items():
                rows.append(_row(method, aim, f"{name} deg", interval(angle[:, m, a], statistic), PAPER.get(name)))
            rows.append(_row(method, aim, "wrong sphere", interval(wrong[:, m, a], STATISTICS["mean"])))
            rows.append(_row(method, aim, "trials with a wrong sphere", share(np.any(wrong[:, m, a], axis=1))))
            if method != "pairwise":
                rows.append(_paired(method, aim, angle[:, m, a].mean(axis=1) - angle[:, 0, a].mean(axis=1)))
    for m, method in enumerate(METHODS):
        rows.append(_row(method, "", "trials registered", share(np.array([t.registered[m] for t in trials]))))
    return rows


def reproduced(ours: Interval, paper: float) -> str:
    """Whether an interval contains the paper's figure or lies below it."""
    if ours.low > paper:
        return "no"
    return "yes" if ours.high >= paper else "yes, lower"


def _paired(method: str, aim: str, difference: Array) -> dict[str, Any]:
    """How much smaller (below 0) the angles of trials are than by the paper's method."""
    from scipy.stats import wilcoxon

    row = _row(method, aim, "mean minus pairwise deg", interval(difference, STATISTICS["mean"]))
    return row | {"p": float(wilcoxon(difference).pvalue)}


def _row(method: str, aim: str, statistic: str, of: Interval, paper: float | None = None) -> dict[str, Any]:
    return {
        "method": method,
        "aim": aim,
        "statistic": statistic,
        **of._asdict(),
        "paper": "" if paper is None else paper,
        "reproduced": "" if paper is None else reproduced(of, paper),
        "p": "",
    }


def main(argv: Sequence[str] | None = None) -> None:
    """The table and the figure."""
    began = perf_counter()
    options = options_of(__doc__, argv)
    count = USERS * TRIALS * (FULL if options.full else 1)
    trials = results_of(trial, [(options.seed, k) for k in range(count)], options)
    made, axes = figure(columns=2, height=3.2)
    _draw_angles(axes[0, 0], np.array([t.angle[:, AIMS.index("human")] for t in trials]))
    _draw_plan(axes[0, 1], np.array([t.shown for t in trials[: USERS * TRIALS]]))
    save("pointing", table(trials), made, options, began)


def _draw_angles(ax: Axes, angle: Array) -> None:
    """How many pointings (n, 3, 4) are within an angle, with intervals over trials."""
    at = np.geomspace(0.3, 60.0, 200)
    random = np.random.default_rng(0)
    drawn = random.integers(len(angle), size=(RESAMPLED, len(angle)))
    half = 50.0 * (1.0 - CONFIDENCE)
    for m, method in enumerate(METHODS):
        within = (angle[:, m, :, None] <= at).mean(axis=1)
        low, high = np.percentile([within[d].mean(axis=0) for d in drawn], [half, 100.0 - half], axis=0)
        ax.fill_between(at, low, high, color=COLOURS[method], alpha=0.2, linewidth=0)
        ax.plot(at, within.mean(axis=0), color=COLOURS[method], linewidth=1.3, label=method)
        ax.plot(angle[:, m].mean(), 0.02, MARKERS[method], color=COLOURS[method], markersize=5)
    ax.axvline(PAPER["mean"], color=COLOURS["bound"], linestyle="--", linewidth=1.0, label="paper")
    ax.set(xlabel="angle (deg)", ylabel="share of pointings within", xscale="log", xlim=(0.3, 60.0), ylim=(0.0, 1.02))
    ticks = [0.3, 1, 3, 10, 30]
    ax.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    ax.legend(fontsize=8, frameon=False, loc="upper left")
    ax.set_title(f"{100.0 * CONFIDENCE:.0f} % bands over trials; markers: means", fontsize=8)


def _draw_plan(ax: Axes, shown: Array) -> None:
    """The chair, the spheres, the user, and where spheres (n, 3, 8, 2) were seen."""
    for m, method in enumerate(METHODS):
        x, y = shown[:, m].reshape(-1, 2).T
        ax.plot(x, y, MARKERS[method], color=COLOURS[method], markersize=2, alpha=0.35, markeredgewidth=0)
    x, y, _ = spheres().T
    ax.plot(x, y, "o", markersize=8, markerfacecolor="none", markeredgecolor="black", label="sphere")
    square = 0.225 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
    ax.plot(*square.T, color="black", linewidth=1.2)
    ax.annotate("chair", (0.0, 0.0), ha="center", va="center", fontsize=7)
    ax.plot(-STAND_M, 0.0, ">", color="black", markersize=8)
    ax.annotate("user", (-STAND_M, -0.3), ha="center", fontsize=8)
    for side in (-1.0, 1.0):
        ray = rotation_2d(side * np.radians(30.0)) @ np.array([0.8, 0.0])
        ax.plot([-STAND_M, ray[0] - STAND_M], [0.0, ray[1]], color="black", linewidth=0.6, linestyle=":")
    ax.set(xlabel="x (m)", ylabel="y (m)", xlim=(-2.4, 1.7), ylim=(-1.7, 1.7), aspect="equal")
    ax.set_title("plan: spheres, and where each trial showed them", fontsize=8)


if __name__ == "__main__":
    main()
