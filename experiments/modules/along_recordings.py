"""Registers a real recording with ranges of simulated modules on its true tracks, beside its own ranges.

`python -m experiments.modules.along_recordings RECORDING [--scheme one-to-n] [--seconds 60] [--seed 0]`: a recording
with truth of everybody. The modules range in the simulated air, always in line of sight, and send by UDP; the stretch
is registered with their ranges and, beside it, with those that came with it. A range's error is beside the truth.

The truth is stamped by the devices' own clocks. In the simulated air these all agree, whatever they did when it was
recorded: what clock offsets there were is told by the recording's own ranges alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.markdown import markdown
from synchronizar.arrays import Mask
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.estimation.register import register
from synchronizar.reporting.evaluate import MAX_GAP_S, evaluate, read_tracks
from synchronizar.simulation.collect import collect
from synchronizar.simulation.modules import Air, scenario_of
from synchronizar.simulation.radios import Device, true_distances
from synchronizar.simulation.scenario import MOST_MODULES
from synchronizar.simulation.scene import SCHEMES

SIGMA_M = 0.03
LEAST_S = 1.0
"""Of truth that a module needs: within a second it has joined the others."""


class Stretch(NamedTuple):
    """The first part of a recording in which two devices are there, with its truth."""

    recording: Recording
    """As it was recorded."""
    truth: Mapping[str, Track]
    """Of every user; from one pose before the stretch to one pose after it."""
    begin: float
    """s, by the devices' clocks and the range clock."""
    seconds: float


class Along(NamedTuple):
    """A stretch with the ranges of modules in place of its own."""

    recording: Recording
    behind: float
    """s, in truth: how much later than when they were measured, by the devices' clocks, ranges are stamped."""


def stretch_of(folder: Path, seconds: float) -> Stretch:
    """The first so many seconds of a recording. Raises InputError where modules cannot ride along it."""
    recording = Recording.load(folder)
    names = [user.name for user in recording.users]
    if len(names) > MOST_MODULES:
        raise InputError(folder, f"has {len(names)} users: modules are at most {MOST_MODULES} in one network")
    truth = read_tracks(folder / "truth") if (folder / "truth").is_dir() else {}
    if missing := [name for name in names if name not in truth]:
        raise InputError(folder, f"has no truth/{missing[0]}.tum: modules ride along the truth of everybody")
    if len(names) < 2 or not recording.tracks:
        raise InputError(folder, "has nobody who moves and somebody else to range with")
    begin = _two_are_there(recording, truth)
    end = min(begin + seconds, max(truth[name].t[-1] for name in recording.tracks))
    own, true = {}, {}
    for name, track in recording.tracks.items():
        place = folder / "truth" / f"{name}.tum"
        t = truth[name].t
        if min(t[-1], end) - max(t[0], begin) < LEAST_S:
            raise InputError(place, f"has less than {LEAST_S:g} s of truth from {begin:g} s to {end:g} s")
        around = slice(max(0, np.searchsorted(t, begin, side="right") - 1), np.searchsorted(t, end) + 1)
        true[name] = _part(truth[name], around)
        within = slice(*np.searchsorted(track.t, [begin, end]))
        if within.start == within.stop:
            raise InputError(folder / "tracks" / f"{name}.tum", f"has no pose from {begin:g} s to {end:g} s")
        own[name] = _part(track, within)
    # A radio that stands still does so at all times.
    standing = {u.name: replace(_part(truth[u.name], slice(1)), t=np.zeros(1)) for u in recording.users if u.static}
    r = recording.ranges
    ranges = r.select((r.t >= begin) & (r.t < end))
    return Stretch(Recording(recording.users, own, ranges), true | standing, begin, end - begin)


def _two_are_there(recording: Recording, truth: Mapping[str, Track]) -> float:
    """s: since when there is truth of a mover and somebody else; of what stands still there always is."""
    first = [-np.inf if user.static else truth[user.name].t[0] for user in recording.users]
    return float(max(np.sort(first)[1], min(truth[name].t[0] for name in recording.tracks)))


def along(stretch: Stretch, scheme: str, seed: int) -> Along:
    """Let modules ride along. Raises InputError where the simulated air is not there or fails."""
    users = tuple(map(_with_one_antenna, stretch.recording.users))
    on_air = _devices(users, stretch.truth, stretch.begin)
    scenario = scenario_of(np.random.default_rng(seed), on_air, Air(stretch.seconds, scheme, SIGMA_M))
    collected = collect(scenario, users)
    ranges = replace(collected.ranges, t=collected.ranges.t + stretch.begin)
    ranges = ranges.select(_truth_is_known(ranges, users, stretch.truth, collected.behind))
    return Along(Recording(users, stretch.recording.tracks, ranges), collected.behind)


def row_of(recording: Recording, truth: Mapping[str, Track], behind: float = 0.0) -> dict[str, Any]:
    """What becomes of a stretch with some ranges, which were measured `behind` s before their stamps."""
    registration = register(recording)
    evaluation = evaluate(registration.tracks(recording), truth, registration.reference)
    states = {name: str(user.state) for name, user in registration.users.items() if name != registration.reference}
    ranges = recording.ranges
    devices = _devices(recording.users, truth, -behind)
    true, there = true_distances(devices, ranges.t, (ranges.a, ranges.antenna_a), (ranges.b, ranges.antenna_b))
    error = 100.0 * (ranges.distance - true)[there]
    pairs = len(np.unique(np.sort(np.column_stack([ranges.a, ranges.b]), axis=1), axis=0))
    return {
        "ranges": len(ranges),
        "pairs": pairs,
        "Hz of a pair": len(ranges) / float(np.ptp(ranges.t)) / pairs if pairs else None,
        "error, cm": f"{error.mean():+.1f} ± {error.std():.1f}" if len(error) else None,
        "states": _told(states),
        "joint_ate_xy, m": evaluation.joint_ate_xy,
        "transfer_xy, m": _told({name: "-" if x is None else f"{x:.3f}" for name, x in evaluation.transfer_xy.items()}),
    }


def _told(of_user: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {word}" for name, word in of_user.items())


def _devices(users: Sequence[User], truth: Mapping[str, Track], clock_offset: float) -> list[Device]:
    """In truth; a mover's own stamp is so much ahead of the clock by which devices are asked where they are."""
    return [
        Device(truth[user.name], True, np.empty((0, 3)), 0.0, bias=0.0)
        if user.static
        else Device(truth[user.name], False, user.levers[:-1], clock_offset, bias=0.0)
        for user in users
    ]


def _with_one_antenna(user: User) -> User:
    return replace(user, antennas=dict(list(user.antennas.items())[:1]))


def _truth_is_known(ranges: Ranges, users: Sequence[User], truth: Mapping[str, Track], behind: float) -> Mask:
    """(n,) whether neither device was in a gap of its truth, across which the air has it move straight on."""
    known = np.ones(len(ranges), dtype=bool)
    for i, user in enumerate(users):
        if not user.static:
            mine = (ranges.a == i) | (ranges.b == i)
            known[mine] &= truth[user.name].at(ranges.t[mine] - behind, MAX_GAP_S).valid
    return known


def _part(track: Track, rows: slice) -> Track:
    return Track(track.t[rows], track.position[rows], track.quat_xyzw[rows])


def main(argv: Sequence[str] | None = None) -> None:
    """The table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--scheme", choices=SCHEMES, default=SCHEMES[0], help="who of the modules sends when")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the recording, from when two are there")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    try:
        stretch = stretch_of(options.recording, options.seconds)
        ridden = along(stretch, options.scheme, options.seed)
        named = {"recording": options.recording.resolve().name}
        rows = [
            named
            | {"ranged by": f"modules, {options.scheme}"}
            | row_of(ridden.recording, stretch.truth, ridden.behind),
            named | {"ranged by": "its own radios"} | row_of(stretch.recording, stretch.truth),
        ]
    except InputError as error:
        sys.exit(str(error))
    print(markdown(rows))


if __name__ == "__main__":
    main()
