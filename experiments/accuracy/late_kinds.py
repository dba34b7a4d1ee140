"""Robustness to NLOS ranges of other kinds than the model assumes.

`python -m experiments.accuracy.late_kinds [--seeds 100] [--users 2 4]`: free walks of 12 s with 30 % of the ranges
late, in bursts of 0.2, 1 and 4 s, whose extra length is steady, fluctuates by a fifth (what the model expects), or is
drawn anew for every range; against the oracle that knows which are late. Errors in the plane, m.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from experiments.common.results import write_table
from experiments.common.walks import beside_oracle, on_all_cores
from synchronizar.arrays import Array
from synchronizar.simulation.scene import SHORTEST_DETOUR_M, Scene
from synchronizar.simulation.simulate import Simulation, simulate

KINDS = ("steady", "a fifth", "anew")


def with_detours(simulation: Simulation, kind: str, seed: int) -> Simulation:
    """The same walk; where its ranges are late, they are so in another way."""
    if kind == "a fifth" or not simulation.late.any():
        return simulation
    random = np.random.default_rng([seed, 5])
    late = np.flatnonzero(simulation.late)
    drawn = SHORTEST_DETOUR_M + random.exponential(simulation.scene.late_mean - SHORTEST_DETOUR_M, len(late))
    if kind == "steady":
        ranges = simulation.recording.ranges
        # One length for each pair's burst: what is more than half a second apart is another burst.
        order = np.lexsort([ranges.t[late], ranges.b[late], ranges.a[late]])
        rows = late[order]
        same = (np.diff(ranges.a[rows]) == 0) & (np.diff(ranges.b[rows]) == 0) & (np.diff(ranges.t[rows]) < 0.5)
        burst = np.concatenate([[0], np.cumsum(~same)])
        lengths = np.empty(len(late))
        lengths[order] = drawn[burst]
        drawn = lengths
    extra = np.zeros(len(simulation.late))
    extra[late] = drawn
    measured = simulation.recording.ranges
    ranges = replace(measured, distance=measured.distance - simulation.extra + extra)
    return replace(simulation, recording=replace(simulation.recording, ranges=ranges), extra=extra)


def errors(kind: str, scene: Scene) -> tuple[Array, Array, list[bool]]:
    """(k - 1,) in the plane: ours and the oracle's; and who is registered."""
    walk = beside_oracle(with_detours(simulate(scene), kind, scene.seed))
    return np.hypot(*walk.ours[:, :2].T), np.hypot(*walk.best[:, :2].T), walk.registered


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 4])
    options = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for users in options.users:
        for burst in (0.2, 1.0, 4.0):
            for kind in KINDS:
                scenes = [
                    Scene(users=users, seed=seed, late_share=0.3, late_burst_s=burst) for seed in range(options.seeds)
                ]
                ours, best, registered = (
                    np.concatenate(column) for column in zip(*on_all_cores(partial(errors, kind), scenes), strict=True)
                )
                rows.append(
                    {
                        "users": users,
                        "burst s": burst,
                        "detour": kind,
                        "n": len(ours),
                        "median": float(np.median(ours)),
                        "ratio": float(np.median(ours) / np.median(best)),
                        "largest": float(ours.max()),
                        "oracle largest": float(best.max()),
                        "registered": float(registered.mean()),
                        "registered, off > 0.6": int((ours[registered] > 0.6).sum()),
                    }
                )
    print(write_table("late_kinds", rows, vars(options)))


if __name__ == "__main__":
    main()
