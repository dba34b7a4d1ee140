"""Accuracy of the rigid model on simulated free walks, against maximum likelihood and the Cramer-Rao bound.

`python -m experiments.accuracy.free_walks [--late 0.3] [--seeds 200] [--users 2 3 4 5 6] [--seconds 12]` simulates free
walks (sigma 0.1 m, every pair at 1000 / (80 + 21 (k - 1)) Hz), registers each, and compares the placements' errors with
those of maximum likelihood under the same model and priors, started at the truth and told which ranges are late, and
with the Cramer-Rao bound. Prints a table and writes it to experiments/results/.
"""

from __future__ import annotations

import argparse

import numpy as np

from experiments.common.results import write_table
from experiments.common.walks import Beside, beside_oracle, on_all_cores
from synchronizar.arrays import Array
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def walk(scene: Scene) -> Beside:
    """Register one scene."""
    return beside_oracle(simulate(scene))


def main() -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--late", type=float, default=0.0)
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--users", type=int, nargs="+", default=[2, 3, 4, 5, 6])
    parser.add_argument("--seconds", type=float, default=12.0)
    options = parser.parse_args()
    rows = []
    for users in options.users:
        scenes = [
            Scene(users=users, seconds=options.seconds, seed=seed, late_share=options.late)
            for seed in range(options.seeds)
        ]
        walks = list(on_all_cores(walk, scenes))
        rows.append(_row(users, walks))
    name = f"free_walks_late_{options.late:g}_{options.seconds:g}s"
    print(write_table(name, rows, settings=vars(options)))


def _row(users: int, walks: list[Beside]) -> dict[str, float]:
    ours, best, bound = (np.concatenate([getattr(w, what) for w in walks]) for what in ("ours", "best", "bound"))
    registered = np.concatenate([w.registered for w in walks])
    rms = {"xy": _rms_plane, "z": lambda e: _rms(e[:, 2]), "yaw": lambda e: _rms(e[:, 3])}
    row: dict[str, float] = {"users": users, "n": len(ours), "registered": float(registered.mean())}
    for what, of in rms.items():
        row |= {f"rms {what}": of(ours), f"ml {what}": of(best), f"bound {what}": of(bound)}
        row[f"ratio {what}"] = of(ours) / of(best)
    plane, plane_best = np.hypot(*ours[:, :2].T), np.hypot(*best[:, :2].T)
    row["median xy"] = float(np.median(plane))
    row["median ratio"] = float(np.median(plane) / np.median(plane_best))
    row |= {"largest xy": float(plane.max()), "ml largest": float(plane_best.max())}
    row["beyond 0.5 m"] = int((plane > 0.5).sum())
    return row


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rms_plane(errors: Array) -> float:
    return _rms(np.hypot(errors[:, 0], errors[:, 1]))


if __name__ == "__main__":
    main()
