"""False and missed registrations: users called `registered` that are off, and users within 0.15 m not called so.

`python -m experiments.accuracy.verdicts [--scenes 300] [--walks 200]`: scenes of many kinds, hard ones (2 to 4 s,
lines, users that stand still, half of the ranges late, chains and stars, static radios) and easy ones mixed, count
users that are called `registered` and are off; free walks of 8 s count users whom maximum likelihood from the truth's
start places within 0.15 m and who are not called so. Off is how far the worst point of the user's own walk (a static
radio: its place) is from where it should be, in three dimensions.
"""

from __future__ import annotations

import argparse
from typing import Any, Literal, NamedTuple

import numpy as np

from experiments.common.results import write_table
from experiments.common.walks import on_all_cores, oracle
from synchronizar.data.registration import State
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.parameters import Parameters
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

OFF = 0.6
PLACED = 0.15
KINDS = ("easy", "short", "line", "still", "late", "mixed", "radios")


class Verdict(NamedTuple):
    """One user of one scene."""

    kind: str
    seed: int
    user: str
    state: State
    off: float
    """m; NaN where it has no placement."""
    off_plane: float
    """m, in x and y alone."""


def scene_of(seed: int) -> tuple[str, Scene]:
    """A scene of some kind; four in ten are easy."""
    random = np.random.default_rng([seed, 2008])
    users = int(random.integers(2, 7))
    kind = "easy" if random.random() < 0.4 else str(random.choice(KINDS[1:]))
    mixture = tuple(str(w) for w in random.choice(["free", "still", "line"], size=users))
    late = {
        "easy": random.choice([0.0, 0.0, 0.1, 0.3]),
        "late": 0.5,
        "mixed": random.uniform(0.1, 0.5),
        "radios": random.uniform(0.0, 0.4),
    }
    seconds = {
        "easy": random.choice([8.0, 12.0, 20.0]),
        "short": random.uniform(2.0, 4.0),
        "mixed": random.uniform(2.0, 8.0),
        "radios": random.uniform(3.0, 12.0),
    }
    scene = Scene(
        users=users,
        seed=seed,
        seconds=float(seconds.get(kind, 12.0)),
        walk={"line": ("line",), "still": mixture, "mixed": mixture}.get(kind, ("free",)),
        late_share=float(late.get(kind, 0.0)),
        late_mean=float(random.choice([0.5, 1.0, 2.0])),
        links=str(random.choice(["all", "star", "chain"])) if kind == "mixed" else "all",
        static_radios=int(random.integers(1, 4)) if kind == "radios" else 0,
    )
    return kind, scene


def verdicts_of(seed_and_model: tuple[int, Literal["full", "rigid"]]) -> list[Verdict]:
    """Every user's verdict in one scene, beside the truth."""
    seed, model = seed_and_model
    kind, scene = scene_of(seed)
    simulation = simulate(scene)
    registration = register(simulation.recording, model=model)
    out = []
    for name, user in registration.users.items():
        if name != registration.reference:
            placed = user.common_from_user is not None
            frame = registration.between(registration.reference, name) if placed else None
            off, off_plane = _off(simulation, registration.reference, name, frame)
            out.append(Verdict(kind, seed, name, user.state, off, off_plane))
    return out


def _off(simulation: Simulation, reference: str, name: str, frame: YawFrame | None) -> tuple[float, float]:
    if frame is None:
        return np.nan, np.nan
    true = simulation.world_from_user[reference].inverse() @ simulation.world_from_user[name]
    track = simulation.recording.tracks.get(name)
    points = np.zeros((1, 3)) if track is None else track.position
    away = frame @ points - true @ points
    return float(np.linalg.norm(away, axis=1).max()), float(np.linalg.norm(away[:, :2], axis=1).max())


def told(task: tuple[int, int, float, Literal["full", "rigid"]]) -> list[bool]:
    """Of the users that maximum likelihood places well after 8 s of free walking: which are registered."""
    seed, users, late, model = task
    simulation = simulate(Scene(users=users, seconds=8.0, seed=seed, late_share=late))
    registration = register(simulation.recording, model=model)
    best = oracle(simulation, registration.reference, Parameters())
    well = np.hypot(best.error[:, 0], best.error[:, 1]) < PLACED
    return [
        user.state is State.REGISTERED
        for u, (name, user) in enumerate(registration.users.items())
        if name != registration.reference and well[u]
    ]


def main() -> None:
    """Both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--walks", type=int, default=200)
    parser.add_argument("--model", choices=["full", "rigid"], default="rigid")
    options = parser.parse_args()
    judged = [
        v
        for scene in on_all_cores(verdicts_of, [(seed, options.model) for seed in range(options.scenes)])
        for v in scene
    ]
    print(write_table(f"verdicts_{options.model}", [_row(kind, judged) for kind in (*KINDS, "all")], vars(options)))
    for v in judged:
        if v.state is State.REGISTERED and v.off > OFF:
            off = f"{v.off:.2f} m, in the plane {v.off_plane:.2f} m"
            print(f"registered and off: {v.kind} scene {v.seed}, {v.user}: {off}")
    rows = []
    for late in (0.0, 0.3) if options.walks else ():
        for users in (2, 4, 6):
            tasks = [(seed, users, late, options.model) for seed in range(options.walks)]
            said = [s for walk in on_all_cores(told, tasks) for s in walk]
            rows.append({"late": late, "users": users, "placed well": len(said), "registered": float(np.mean(said))})
    if rows:
        print()
        print(write_table(f"verdicts_after_8_s_{options.model}", rows, vars(options)))


def _row(kind: str, judged: list[Verdict]) -> dict[str, Any]:
    mine = [v for v in judged if kind in ("all", v.kind)]
    row: dict[str, Any] = {"kind": kind, "scenes": len({v.seed for v in mine}), "users": len(mine)}
    row |= {str(state): sum(v.state is state for v in mine) for state in State}
    registered = [v for v in mine if v.state is State.REGISTERED]
    row[f"registered, off > {OFF}"] = sum(v.off > OFF for v in registered)
    row["in the plane"] = sum(v.off_plane > OFF for v in registered)
    row["well placed, not said"] = sum(v.state is not State.REGISTERED and v.off < PLACED for v in mine)
    return row


if __name__ == "__main__":
    main()
