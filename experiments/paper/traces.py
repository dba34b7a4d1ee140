"""Trace following: figures 10 and 11 of SynchronizAR (Huo et al., UIST 2018).

`python -m experiments.paper.traces [--full] [--seed N] [--scheduler ADDRESS]`

The partner has drawn an L, an S and a spline into 5 x 3 m of the room's floor. 11 users follow each twice with a
perfect registration and twice with an estimated one; --full makes 20 such studies. Each estimate comes from a walk of
its own of the paper's 100 samples, as in `experiments.paper.pointing`, by the same three methods; nobody is left out.
Measured is the modified Hausdorff distance (Dubuisson and Jain, ICPR 1994) between the trace as it stands in the room
and the path that is walked, both in the plan and sampled every centimetre: the larger of the two mean distances to the
nearest.

How people follow what they see: they stray from it to the side, smoothly.
- Gait: the body sways from foot to foot by 6.99 cm in all at 0.7 m/s, a slow walk (Orendurff et al., Journal of
  Rehabilitation Research and Development 41, 2004): a sine of 3.5 cm, once in a stride, whose length of 1.0 m at that
  speed is assumed.
- Path: people correct their place on a path only gradually from step to step (Dingwell and Cusumano, PLOS Computational
  Biology 15, 2019), so they stray slowly. How much is assumed here: 3 cm, 1 sigma, hanging together over 1 m of path.

Which traces the paper drew, how many people followed them and in what frame it measured the walked path is not known
here: the shapes and the 11 users of its pointing study are assumed.

Statistics: Welch's t-test per trace between perfect and estimated, on the 22 against 22 walks of one study; `p` is the
median over studies and `significant` the share of studies with p < 0.05. A large p from few walks is no proof of
equality, so over all walks there are besides: Cohen's d; the power that one study had to find a difference of the
margin, and what difference it `finds` with 80 % power (m); and a test of equivalence (two one-sided Welch tests): equal
within the margin where `p_equal` < 0.05. The margin is 0.05 m: half a foot's breadth of 0.10 m (Gordon et al., ANSUR,
1989), by which a foot still stands on the line.

The paper found no significant difference. That is not reproduced (`no`) where half of the studies or more find one;
reproduced (`yes`) where fewer do and both are equal within the margin; and `undecided` where fewer do but equality is
not shown either, the finding being one of low power then.
"""

from __future__ import annotations

from collections.abc import Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from experiments.common.methods import METHODS
from experiments.common.study import COLOURS, Interval, figure, interval, options_of, points, results_of, save
from experiments.paper.pointing import FULL, STATISTICS, USERS, seen_from_true, walk_of
from synchronizar.arrays import Array

FOLLOWED = 2
"""How often a user follows each trace in each condition."""
PAPER = {"L": 0.92, "S": 0.77, "spline": 0.55}
"""p of the paper's t-tests."""
LENGTH_M, WIDTH_M = 5.0, 3.0
SAMPLED_M = 0.01
MARGIN_M = 0.05
MEAN_HEIGHT, POWER = 0.05, 0.8
CERTAIN = 2.5
"""Cohen's d, which 22 against 22 walks find with certainty; the distribution beyond is out of scipy's reach."""

SWAY_M, STRIDE_M = 0.5 * 0.0699, 1.0
STRAY_M, STRAY_LENGTH_M = 0.03, 1.0
CORNER_M = 0.1
"""1 sigma of the smoothing that gives a corner its normals: people turn in it, not at it."""


class Follow(NamedTuple):
    """One user who follows one trace once with a perfect and once with each estimated registration."""

    perfect: float
    """m."""
    estimated: Array
    """(3,) m, by method."""
    paths: Array
    """(2, n, 2) m: the path walked with a perfect registration, and that by our method."""


def trace(name: str) -> Array:
    """(n, 2) m: a trace, sampled evenly, in a box of 5 x 3 m about 0."""
    from scipy.interpolate import CubicSpline

    if name == "L":
        corners = np.array([[0.0, WIDTH_M], [0.0, 0.0], [LENGTH_M, 0.0]])
    elif name == "S":
        x = np.linspace(0.0, LENGTH_M, 2000)
        corners = np.column_stack([x, 0.5 * WIDTH_M * (1.0 + np.sin(2.0 * np.pi * x / LENGTH_M))])
    else:
        knots = np.array([[0.0, 0.2], [0.8, 2.2], [2.0, 2.4], [2.9, 0.9], [4.0, 0.7], [5.0, 2.6]])
        corners = CubicSpline(np.arange(len(knots)), knots)(np.linspace(0.0, len(knots) - 1.0, 2000))
    return evenly(corners - np.array([0.5 * LENGTH_M, 0.5 * WIDTH_M]))


def evenly(line: Array) -> Array:
    """A line (m, 2) sampled every centimetre of its length."""
    length = _length_along(line)
    at = np.linspace(0.0, length[-1], round(length[-1] / SAMPLED_M) + 1)
    return np.column_stack([np.interp(at, length, line[:, 0]), np.interp(at, length, line[:, 1])])


def modified_hausdorff(a: Array, b: Array) -> float:
    """Of point sets (n, 2) and (m, 2): the larger of the mean distances from one's points to the other's nearest."""
    from scipy.spatial import KDTree

    return max(float(KDTree(b).query(a)[0].mean()), float(KDTree(a).query(b)[0].mean()))


def walked(random: np.random.Generator, shown: Array) -> Array:
    """(n, 2) the path of somebody who follows a line that is shown (m, 2), sampled evenly."""
    from scipy.ndimage import gaussian_filter1d

    length = _length_along(shown)
    # A Gaussian kernel over white noise: the correlation falls off over sqrt(2) times the kernel's width.
    width = STRAY_LENGTH_M / np.sqrt(2.0) / SAMPLED_M
    padding = round(4.0 * width)
    stray = gaussian_filter1d(random.standard_normal(len(shown) + 2 * padding), width)[padding:-padding]
    stray *= STRAY_M * np.sqrt(2.0 * np.sqrt(np.pi) * width)
    sway = SWAY_M * np.sin(2.0 * np.pi * (length / STRIDE_M + random.uniform()))
    along = np.gradient(gaussian_filter1d(shown, CORNER_M / SAMPLED_M, axis=0, mode="nearest"), axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    left = np.column_stack([-along[:, 1], along[:, 0]])
    return evenly(shown + (stray + sway)[:, None] * left)


def follow(task: tuple[int, int, str]) -> Follow:
    """(seed of the study, number of the walk, trace)."""
    seed, number, name = task
    walk = walk_of(seed, number, list(PAPER).index(name))
    random = np.random.default_rng((seed, number, list(PAPER).index(name)))
    true = trace(name)
    perfect = walked(random, true)
    again = random.integers(2**32)  # whoever follows is the same person at the same moment, whatever the method
    paths = {}
    for method, registered in METHODS.items():
        seen = seen_from_true(walk, registered(walk.recording)) @ np.column_stack([true, np.zeros(len(true))])
        paths[method] = walked(np.random.default_rng(again), evenly(seen[:, :2]))
    estimated = np.array([modified_hausdorff(true, path) for path in paths.values()])
    n = min(len(perfect), len(paths["joint"]))
    return Follow(modified_hausdorff(true, perfect), estimated, np.stack([perfect[:n], paths["joint"][:n]]))


def row(name: str, method: str, perfect: Array, estimated: Array) -> dict[str, Any]:
    """What is told of a trace and a method, of distances (studies, walks)."""
    from scipy.stats import ttest_ind
    from statsmodels.stats.power import TTestIndPower
    from statsmodels.stats.weightstats import ttost_ind

    p = ttest_ind(perfect, estimated, axis=1, equal_var=False).pvalue
    one, other = perfect.ravel(), estimated.ravel()
    spread = float(np.sqrt(0.5 * (one.var(ddof=1) + other.var(ddof=1))))
    n = perfect.shape[1]
    smallest = TTestIndPower().solve_power(nobs1=n, alpha=MEAN_HEIGHT, power=POWER)
    significant = float(np.mean(p < MEAN_HEIGHT))
    p_equal = float(ttost_ind(one, other, -MARGIN_M, MARGIN_M, usevar="unequal")[0])
    mean = STATISTICS["mean"]
    return {
        "trace": name,
        "method": method,
        "n": n,
        "studies": len(perfect),
        **_columns("perfect", interval(one, mean)),
        **_columns("estimated", interval(other, mean)),
        "median": float(np.median(other)),
        "d": float(other.mean() - one.mean()) / spread,
        "p": float(np.median(p)),
        "significant": significant,
        "paper p": PAPER[name],
        "reproduced": "no" if significant >= 0.5 else "yes" if p_equal < MEAN_HEIGHT else "undecided",
        "power": float(TTestIndPower().power(min(MARGIN_M / spread, CERTAIN), n, MEAN_HEIGHT)),
        "finds": float(smallest * spread),
        "p_equal": p_equal,
    }


def main(argv: Sequence[str] | None = None) -> None:
    """The table and the figure."""
    began = perf_counter()
    options = options_of(__doc__, argv)
    studies, walks = FULL if options.full else 1, USERS * FOLLOWED
    tasks = [(options.seed, k, name) for name in PAPER for k in range(studies * walks)]
    results = results_of(follow, tasks, options)
    made, axes = figure(columns=3, rows=2)
    rows = []
    for t, name in enumerate(PAPER):
        followed = results[t * studies * walks : (t + 1) * studies * walks]
        perfect = np.array([f.perfect for f in followed]).reshape(studies, walks)
        estimated = np.array([f.estimated for f in followed]).reshape(studies, walks, len(METHODS))
        rows += [row(name, method, perfect, estimated[..., m]) for m, method in enumerate(METHODS)]
        _draw_paths(axes[0, t], name, [f.paths for f in followed[:6]])
        _draw_distances(axes[1, t], perfect.ravel(), estimated.reshape(-1, len(METHODS)))
    axes[0, 0].legend(fontsize=7, frameon=False, loc="upper right")
    axes[0, 0].set_ylabel("y (m)")
    axes[1, 0].set_ylabel("modified Hausdorff distance (m)", fontsize=8)
    save("traces", rows, made, options, began)


def _length_along(line: Array) -> Array:
    """(n,) m from a line's (n, 2) beginning."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])


def _columns(name: str, of: Interval) -> dict[str, float]:
    return {name: of.value, f"{name} low": of.low, f"{name} high": of.high}


def _draw_paths(ax: Axes, name: str, paths: Sequence[Array]) -> None:
    """A trace, and paths (2, n, 2) walked with perfect and with our registrations."""
    for k, (perfect, joint) in enumerate(paths):
        ax.plot(*perfect.T, color="0.6", linewidth=0.8, label="perfect" if k == 0 else None)
        ax.plot(*joint.T, color=COLOURS["joint"], linewidth=0.6, alpha=0.7, label="joint" if k == 0 else None)
    ax.plot(*trace(name).T, color="black", linewidth=1.4, label="trace")
    ax.set(xlabel="x (m)", title=name, xlim=(-3.0, 3.0), ylim=(-2.2, 2.2), aspect="equal")


def _draw_distances(ax: Axes, perfect: Array, estimated: Array) -> None:
    """All distances (n,) and (n, 3), with the means' intervals."""
    random = np.random.default_rng(0)
    columns = {"bound": perfect, **dict(zip(METHODS, estimated.T, strict=True))}
    for x, (colour, values) in enumerate(columns.items()):
        at = x + random.uniform(-0.25, 0.25, len(values))
        ax.plot(at, values, ".", color="0.75", markersize=2, zorder=1)
        points(ax, np.array([float(x)]), [interval(values, STATISTICS["mean"])], colour)
    ax.set(yscale="log", ylim=(0.01, 1.0))
    ax.set_yticks([0.01, 0.1, 1.0], ["0.01", "0.1", "1"])
    ax.set_xticks(range(len(columns)), ["perfect", *METHODS], fontsize=7)


if __name__ == "__main__":
    main()
