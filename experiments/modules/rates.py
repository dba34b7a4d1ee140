"""Ranging rates and errors of the modules' firmware in the simulated air, and how modules join and leave.

`python -m experiments.modules.rates [--seconds 4] [--repeats 4]`. Modules stand on a circle of 3 m, their crystals up
to 20 ppm off, their stamps so noisy that ranges are good to 2 cm. Errors are those of ranges in line of sight unless
stated otherwise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from experiments.common.markdown import markdown
from experiments.common.results import write_table
from synchronizar.arrays import Array
from synchronizar.data.ranges import SOURCES, Ranges
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.user import User
from synchronizar.simulation.collect import collect
from synchronizar.simulation.modules import CRYSTAL_PPM, RANGE_OF_STAMP, SWITCHED_ON_S, blockage_of
from synchronizar.simulation.scenario import Module, Scenario
from synchronizar.simulation.scene import SCHEMES, Scene

PARTNERS = (1, 2, 3, 5, 10)
RADIUS_M = 3.0
RANGE_SIGMA_M = 0.02
JOINED_S = {"one-to-n": 4.0, "all-pairs": 4.0, "polling": 40.0}
"""Everybody is there by then."""
DESIGNED_HZ: dict[str, Callable[[int], float]] = {
    "one-to-n": lambda n: 1000.0 / (n + 2),
    "all-pairs": lambda n: 1000.0 / (n + 1),
    "polling": papers_rate_hz,
}
"""Rounds a second with n partners, in slots of 1 ms, and the paper's."""
LOSSES = (0.0, 0.1, 0.3)
LATE_SHARES, LATE_SECONDS = (0.0, 0.1, 0.3), 30.0
BEGINS_S, COMES_S, GOES_S, ENDS_S = 0.3, 3.0, 6.0, 10.0
"""When the other modules are switched on after the first one, when one comes besides, and when one loses power."""


class Circle(NamedTuple):
    """Ranges on the circle."""

    ranges: Ranges
    error: Array
    """(n,) m: measured minus true."""
    measured: Array
    """(n,) s: when they truly were."""


def circle(scenario: Scenario) -> Circle:
    """Run a scenario and compare with the truth."""
    users = [User(f"module{i:02d}") for i in range(len(scenario.modules))]
    collected = collect(scenario, users)
    ranges = collected.ranges
    place = np.array([module.position[0] for module in scenario.modules])
    error = ranges.distance - np.linalg.norm(place[ranges.a] - place[ranges.b], axis=1)
    return Circle(ranges, error, ranges.t - collected.behind)


def standing(random: np.random.Generator, scheme: str, partners: int, seconds: float, loss: float = 0.0) -> Scenario:
    """Modules on the circle, all of them switched on within a moment."""
    angles = 2.0 * np.pi * np.arange(partners + 1) / (partners + 1)
    places = RADIUS_M * np.column_stack([np.cos(angles), np.sin(angles), 0.5 * np.cos(3.0 * angles)])
    modules = []
    for place in places:
        ppm, board_ppm = random.uniform(-CRYSTAL_PPM, CRYSTAL_PPM, 2).tolist()
        modules.append(Module(ppm, board_ppm, SWITCHED_ON_S * random.uniform(), np.zeros(1), place[None, :]))
    return Scenario(
        seconds=seconds,
        scheme=scheme,
        seed=int(random.integers(2**32)),
        session=int(random.integers(2**32)),
        key=random.bytes(32),
        stamp_sigma=RANGE_SIGMA_M / RANGE_OF_STAMP,
        frame_loss=loss,
        modules=modules,
    )


def pair_times(ranges: Ranges, count: int) -> dict[tuple[int, int], Array]:
    """When each pair of so many modules ranged, in order; nothing where it never did."""
    low, high = np.minimum(ranges.a, ranges.b), np.maximum(ranges.a, ranges.b)
    return {(a, b): ranges.t[(low == a) & (high == b)] for b in range(count) for a in range(b)}


def rate_row(random: np.random.Generator, scheme: str, partners: int, seconds: float) -> dict[str, Any]:
    """How often each pair ranges, and how well."""
    joined = JOINED_S[scheme]
    ranges, error, _ = circle(standing(random, scheme, partners, joined + seconds))
    steady = ranges.t >= joined
    times = pair_times(ranges.select(steady), partners + 1)
    hz = np.array([len(t) / seconds for t in times.values()])
    measured = float(hz[hz > 0.0].mean())
    everybody = max(ranges.t[(ranges.a == i) | (ranges.b == i)].min(initial=np.inf) for i in range(partners + 1))
    return {
        "scheme": scheme,
        "n": partners,
        "designed, Hz": DESIGNED_HZ[scheme](partners),
        "measured, Hz": measured,
        "times the paper's": measured / papers_rate_hz(partners),
        "pairs that range": f"{(hz > 0.0).sum()} of {len(hz)}",
        "all joined, s": float(everybody),
        "mean error, cm": 100.0 * float(error.mean()),
        "sd, cm": 100.0 * float(error.std()),
        "largest, cm": 100.0 * float(np.abs(error).max()),
    }


def loss_row(random: np.random.Generator, scheme: str, partners: int, loss: float, seconds: float) -> dict[str, Any]:
    """The same where frames are lost, and by who measured."""
    joined = JOINED_S[scheme]
    ranges, error, _ = circle(standing(random, scheme, partners, joined + seconds, loss))
    hz = np.array([len(t) for t in pair_times(ranges.select(ranges.t >= joined), partners + 1).values()]) / seconds
    row: dict[str, Any] = {
        "scheme": scheme,
        "n": partners,
        "frames lost": loss,
        "measured, Hz": float(hz.mean()),
        "of designed": float(hz.mean()) / DESIGNED_HZ[scheme](partners),
        "all three come": (1.0 - loss) ** 3,
    }
    for source in ("module", "overheard"):
        mine = error[ranges.source == SOURCES.index(source)]
        row[f"{source}: mean, sd, cm"] = f"{100 * mine.mean():+.2f}, {100 * mine.std():.2f}" if len(mine) else None
    return row | {"largest, cm": 100.0 * float(np.abs(error).max())}


def late_row(random: np.random.Generator, scheme: str, share: float) -> dict[str, Any]:
    """Three modules, some of whose signals come late: errors, and the modules' own hints."""
    scene = Scene(users=3, seconds=LATE_SECONDS, late_share=share)
    blockage = blockage_of(random, scene)
    ranges, error, measured = circle(replace(standing(random, scheme, 2, scene.seconds), blocked=blockage.spans()))
    extra = blockage.at(measured, ranges.a, ranges.b)
    late = extra > 0.0
    row: dict[str, Any] = {"scheme": scheme, "late": float(late.mean())}
    for sight, mine in (("clear", ~late), ("late", late)):
        of, nlos = (error - extra)[mine], ranges.nlos[mine]
        row |= {
            f"{sight}: beside what was put in, cm": f"{100 * of.mean():+.2f} ± {100 * of.std():.2f}"
            if len(of)
            else None,
            f"{sight}: said to be blocked": float(np.mean(nlos == 1.0)) if len(of) else None,
            f"{sight}: said to be clear": float(np.mean(nlos == 0.0)) if len(of) else None,
        }
    return row


def change_row(random: np.random.Generator, scheme: str, partners: int, repeats: int) -> dict[str, Any]:
    """One comes to a network of n + 1; a member loses power, without a word; the coordinator does. Worst of repeats."""
    joined, member, coordinator = [], [], []
    for _ in range(repeats):
        for who, silent in ((1, member), (0, coordinator)):
            scenario = standing(random, scheme, partners + 1, ENDS_S)
            came, went = (t + random.uniform() for t in (COMES_S, GOES_S))
            # The first one coordinates.
            on = [0.0, *(BEGINS_S + SWITCHED_ON_S * random.uniform() for _ in range(partners)), came]
            modules = [
                replace(m, on=t, off=went if i == who else np.inf)
                for i, (m, t) in enumerate(zip(scenario.modules, on, strict=True))
            ]
            times = pair_times(circle(replace(scenario, modules=modules)).ranges, partners + 2)
            with_new = [t for pair, t in times.items() if partners + 1 in pair]
            joined.append(min(t.min(initial=np.inf) for t in with_new) - came)
            rest = np.sort(np.concatenate([t for pair, t in times.items() if who not in pair]))
            after = rest[rest > went - 0.1]
            silent.append(float(np.diff(after).max(initial=0.0)) if len(after) else np.inf)
    return {
        "scheme": scheme,
        "n": partners,
        "a joiner ranges after, s: median": float(np.median(joined)),
        "worst": float(max(joined)),
        "a member lost: the others silent for, s, worst": float(max(member)),
        "the coordinator lost: the others silent for, s, worst": float(max(coordinator)),
    }


def main() -> None:
    """The tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=4.0, help="of ranging, after all have joined")
    parser.add_argument("--repeats", type=int, default=4, help="of joining and leaving")
    options = parser.parse_args()
    seconds, random = options.seconds, np.random.default_rng(0)
    fast = ("one-to-n", "all-pairs")
    tables = {
        "module_rates": [rate_row(random, scheme, n, seconds) for scheme in SCHEMES for n in PARTNERS],
        "module_losses": [loss_row(random, s, n, loss, seconds) for s in fast for n in (2, 5) for loss in LOSSES],
        "module_late": [late_row(random, scheme, share) for scheme in fast for share in LATE_SHARES],
        "module_changes": [change_row(random, scheme, n, options.repeats) for scheme in fast for n in (2, 5)],
    }
    for name, rows in tables.items():
        write_table(name, rows, vars(options))
        print(f"\n{name}\n\n{markdown(rows, digits=2)}")


if __name__ == "__main__":
    main()
