"""What goes wrong with a walk: devices' places, their SLAM, their ranges, their settings, how poses are written.

Each fault takes a trial and a generator that draws when, to whom and how badly it happens. They are applied in the
order of KINDS in `families`: the world first, then SLAM's frames, ranges, settings, and how poses come.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from experiments.accuracy.late_kinds import with_detours
from experiments.common.faults import jumped, sliding
from experiments.integrity.trial import Trial
from synchronizar.arrays import Array, Mask
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.quaternions import IDENTITY, yaw_quaternions
from synchronizar.simulation.radios import DETOUR_FLUCTUATION
from synchronizar.simulation.scene import SHORTEST_DETOUR_M

Random = np.random.Generator
Fault = Callable[[Trial, Random], Trial]

ODD_RADIO_M = 0.9
POCKET_S = 10.0
DAY_S = 86400.0
EPOCH_S = 1.7e9
FOOT_M = 0.3048


# ---- where devices are ----


def odd_body(trial: Trial, random: Random) -> Trial:
    """One of them is a robot, sits, or is a drone that goes up and down, as its SLAM sees."""
    name, kind = _somebody(trial, random), random.choice(["robot", "seated", "drone"])
    low, high = {"robot": (-1.1, -0.6), "seated": (-0.6, -0.4), "drone": (0.6, 2.0)}[str(kind)]
    t = trial.simulation.truth[name].t
    up = np.zeros((len(t), 4))
    up[:, 2] = random.uniform(low, high)
    if kind == "drone":
        period, phase = random.uniform(6.0, 15.0), random.uniform(-np.pi, np.pi)
        course = random.uniform(0.2, 0.8) * np.sin(2.0 * np.pi * (t - t[0]) / period + phase)
        up[:, 2] += course
        seen = np.zeros((len(t), 4))
        seen[:, 2] = (course - course[0]) / trial.scale[name]
        trial = trial.with_climb(name, seen)
    return trial.with_carried({name: up})


def carried(trial: Trial, random: Random) -> Trial:
    """A lift or a train takes one or two along; their SLAM sees its cabin."""
    begin = trial.moments(random.uniform(0.3, 0.6))
    end = begin + random.uniform(3.0, 8.0)
    speed = random.uniform(0.3, 1.0)
    velocity = np.array([0.0, 0.0, speed * random.choice([-1.0, 1.0])])
    if random.random() < 0.5:
        velocity = _aside(random, 2.0 * speed)
    whom = random.permutation(trial.moving)[: random.integers(1, 3)].tolist()
    return trial.with_carried(
        {name: sliding(trial.simulation.truth[name].t, velocity, begin, end) for name in whom}
    ).without_best()


# ---- SLAM's frames ----


def slip(trial: Trial, random: Random) -> Trial:
    """SLAM slides away for some seconds, or is elsewhere within one: its attitudes show nothing."""
    name = _anybody(trial, random)
    begin = trial.moments(random.uniform(0.25, 0.75))
    lasts = random.choice([0.3, random.uniform(1.0, 6.0)])
    length = random.uniform(0.5, 4.0)
    t = trial.honest[name].t
    moved = sliding(t, _aside(random, length / lasts), begin, begin + lasts)
    return trial.spoiled(_until(trial, name, begin + lasts)).with_own_frames(name, moved)


def relocalisation(trial: Trial, random: Random) -> Trial:
    """SLAM jumps to another frame, in place and heading."""
    name = _anybody(trial, random)
    begin = trial.moments(random.uniform(0.2, 0.8))
    shift, turn = _aside(random, random.choice([0.5, 1.0, 2.0, 5.0])), random.uniform(-np.pi, np.pi)
    track = trial.honest[name]
    moved = jumped(track, track.t >= begin, shift, turn)
    return trial.spoiled(_until(trial, name, begin)).with_own_frames(name, moved)


def two_maps(trial: Trial, random: Random) -> Trial:
    """SLAM takes one place for another and back, several times."""
    name = _anybody(trial, random)
    track, begin = trial.honest[name], trial.moments(random.uniform(0.2, 0.5))
    after, every = track.t - begin, random.uniform(2.0, 5.0)
    other = (after >= 0.0) & (after < 3.0 * every) & (after % every < 0.5 * every)
    if not other.any():
        return trial
    moved = jumped(track, other, _aside(random, random.uniform(0.5, 3.0)), random.uniform(-np.pi, np.pi))
    return trial.spoiled(_until(trial, name, begin + 3.0 * every)).with_own_frames(name, moved)


def other_unit(trial: Trial, random: Random) -> Trial:
    """One device's own track is in feet, centimetres or millimetres."""
    return trial.with_lengths(_anybody(trial, random), float(random.choice([1.0 / FOOT_M, 100.0, 1000.0])))


def georeferenced(trial: Trial, random: Random) -> Trial:
    """Own tracks begin at UTM coordinates, some or all."""
    names = trial.moving if random.random() < 0.5 else [_anybody(trial, random)]
    for name in names:
        moved = np.zeros((len(trial.honest[name]), 4))
        moved[:, :3] = 5e5 + random.uniform(-2e5, 2e5), random.uniform(4.5e6, 6e6), random.uniform(0.0, 500.0)
        trial = trial.with_own_frames(name, moved)
    return trial


# ---- ranges ----


def other_detours(trial: Trial, random: Random) -> Trial:
    """NLOS ranges whose extra length is steady, or drawn anew each time."""
    kind = str(random.choice(["steady", "anew"]))
    other = with_detours(trial.simulation, kind, trial.simulation.scene.seed)
    return trial.with_ranges(other.recording.ranges, trial.simulation.late)


def blocked_pair(trial: Trial, random: Random) -> Trial:
    """Two devices have no line of sight throughout."""
    r = trial.recording.ranges
    row = int(random.integers(len(r)))
    blocked = (r.a == r.a[row]) & (r.b == r.b[row])
    return trial.with_added(_detour(random, blocked))


def pocket(trial: Trial, random: Random) -> Trial:
    """A device is in a pocket for ten seconds: all its ranges are late."""
    name = _anybody(trial, random)
    begin = trial.moments(random.uniform(0.0, 0.6))
    r = trial.recording.ranges
    rows = trial.of_device(name) & (r.t >= begin) & (r.t < begin + POCKET_S)
    extra = np.zeros(len(r))
    for other in range(len(trial.recording.users)):  # each signal has its own way around the body
        extra += _detour(random, rows & ((r.a == other) | (r.b == other)) & (other != trial.recording.index(name)))
    return trial.with_added(extra)


def short_ranges(trial: Trial, random: Random) -> Trial:
    """Ranges of a pair or of a device are metres short for some seconds, or are what they were before."""
    r = trial.recording.ranges
    begin = trial.moments(random.uniform(0.1, 0.7))
    rows = (r.t >= begin) & (r.t < begin + random.uniform(2.0, 6.0)) & trial.of_device(_anybody(trial, random))
    if random.random() < 0.5:
        rows &= trial.of_device(_anybody(trial, random))
    short = np.minimum(random.uniform(1.0, 5.0), np.maximum(r.distance - 0.1, 0.0))
    return trial.with_added(np.where(rows, -short, 0.0))


def odd_radio(trial: Trial, random: Random) -> Trial:
    """One radio adds 0.9 m to each of its ranges."""
    name = _anybody(trial, random)
    ranges = trial.recording.ranges
    longer = replace(ranges, distance=ranges.distance + ODD_RADIO_M * trial.of_device(name))
    out = trial.with_recording(ranges=longer)
    if out.best is None:
        return out
    best = out.best
    told = replace(best.recording.ranges, distance=best.recording.ranges.distance + ODD_RADIO_M * trial.of_device(name))
    bias = {**best.range_bias, name: best.range_bias[name] + ODD_RADIO_M}
    return replace(out, best=replace(best, recording=replace(best.recording, ranges=told), range_bias=bias))


def swapped_radios(trial: Trial, random: Random) -> Trial:
    """Two wear each other's radio, for some seconds or throughout."""
    pair = [trial.recording.index(name) for name in random.permutation(trial.moving)[:2]]
    other = np.arange(len(trial.recording.users), dtype=np.int32)
    other[pair] = pair[::-1]
    r = trial.recording.ranges
    throughout = bool(random.random() < 0.4)
    begin = trial.moments(random.uniform(0.1, 0.6))
    then = (r.t >= begin) & (r.t < begin + random.uniform(4.0, 10.0)) | throughout
    ranges = replace(r, a=np.where(then, other[r.a], r.a), b=np.where(then, other[r.b], r.b))
    out = trial.with_ranges(ranges, then & (np.isin(r.a, pair) | np.isin(r.b, pair)))
    return out.without_best() if throughout else out


# ---- settings ----


def surveyed(trial: Trial, random: Random) -> Trial:
    """The radios that stand still were surveyed."""
    return _surveyed(trial, random, 0)


def wrongly_surveyed(trial: Trial, random: Random) -> Trial:
    """The same with one entry that is wrong by metres."""
    return _surveyed(trial, random, 1)


def _surveyed(trial: Trial, random: Random, wrong: int) -> Trial:
    x, y, z, yaw = (random.uniform(-1.0, 1.0, 4) * [30.0, 30.0, 3.0, np.pi]).tolist()
    room_from_survey = YawFrame(x, y, z, yaw)
    radios = [user for user in trial.recording.users if user.static]
    entries = {}
    for n, user in enumerate(random.permutation(np.array(radios, dtype=object)).tolist()):
        place = room_from_survey.inverse() @ trial.simulation.truth[user.name].position[0]
        place = place + 0.02 * random.standard_normal(3)
        if n < wrong:
            place = place + _aside(random, random.uniform(1.0, 4.0))
        entries[user.name] = replace(user, position=tuple(place.tolist()))
    return trial.surveyed(entries, room_from_survey)


def one_radio_of_all(trial: Trial, _: Random) -> Trial:
    """The radios that stand still are told as the antennas of one, which is on the floor in the middle of the room."""
    radios = [user.name for user in trial.recording.users if user.static]
    places = {name: tuple(trial.simulation.truth[name].position[0].tolist()) for name in radios}
    one = replace(trial.recording.users[trial.recording.index(radios[0])], antennas=places)
    users = tuple(
        one if user.name == one.name else user for user in trial.recording.users if user.name not in radios[1:]
    )
    names = [user.name for user in users]
    index = np.array(
        [names.index(one.name if user.name in radios else user.name) for user in trial.recording.users], dtype=np.int32
    )
    antenna = np.array([radios.index(u.name) if u.static else -1 for u in trial.recording.users], dtype=np.int32)
    r = trial.recording.ranges
    ends = {
        "a": index[r.a],
        "b": index[r.b],
        "antenna_a": np.where(antenna[r.a] < 0, r.antenna_a, antenna[r.a]),
        "antenna_b": np.where(antenna[r.b] < 0, r.antenna_b, antenna[r.b]),
    }
    floor = replace(trial.simulation.truth[one.name], position=np.zeros((1, 3)))
    truth = {name: track for name, track in trial.simulation.truth.items() if name not in radios} | {one.name: floor}
    out = trial.with_recording(users=users, ranges=replace(r, **ends))
    return replace(out, simulation=replace(out.simulation, truth=truth)).without_best()


# ---- how poses come ----


def sparse(trial: Trial, random: Random) -> Trial:
    """Two to five poses a second, of one or of all."""
    every = round(trial.simulation.scene.track_rate_hz / random.uniform(2.0, 5.0))
    for name in trial.moving if random.random() < 0.5 else [_anybody(trial, random)]:
        trial = trial.with_garbled(name, _rows(trial.recording.tracks[name], slice(None, None, max(every, 1))))
        if trial.best is not None:
            kept = {
                what: {**tracks, name: _rows(tracks[name], slice(None, None, max(every, 1)))}
                for what, tracks in (("own", trial.best.recording.tracks), ("truth", trial.best.truth))
            }
            recording = replace(trial.best.recording, tracks=kept["own"])
            trial = replace(trial, best=replace(trial.best, recording=recording, truth=kept["truth"]))
    return trial


def frozen(trial: Trial, random: Random) -> Trial:
    """The last pose repeated for seconds, once or more often."""
    name = _anybody(trial, random)
    track = trial.recording.tracks[name]
    row = np.arange(len(track))
    spoiled = np.zeros(len(trial.recording.ranges), dtype=bool)
    for _ in range(int(random.integers(1, 4))):
        begin = trial.moments(random.uniform(0.1, 0.8))
        end = begin + random.uniform(1.0, 5.0)
        row[(track.t >= begin) & (track.t < end)] = max(int(np.searchsorted(track.t, begin)) - 1, 0)
        t = trial.recording.ranges.t
        spoiled |= trial.of_device(name) & (t >= begin) & (t < end)
    held = replace(track, position=track.position[row], quat_xyzw=track.quat_xyzw[row])
    return trial.spoiled(spoiled).with_garbled(name, held)


def stray_stamp(trial: Trial, random: Random) -> Trial:
    """One pose is stamped a day ahead, or the first one 0 where all others count from 1970."""
    name = _anybody(trial, random)
    track = trial.recording.tracks[name]
    if random.random() < 0.5:
        at = int(random.integers(len(track)))
        t, row = np.append(track.t, track.t[at] + DAY_S), np.append(np.arange(len(track)), at)
        return trial.with_garbled(name, Track(t, track.position[row], track.quat_xyzw[row]))
    trial = trial.later(EPOCH_S)
    stamps = trial.recording.tracks[name].t.copy()
    stamps[0] = 0.0
    return trial.with_garbled(name, replace(trial.recording.tracks[name], t=stamps))


def clock_step(trial: Trial, random: Random) -> Trial:
    """A device's clock is put forward."""
    name = _anybody(trial, random)
    track, begin = trial.recording.tracks[name], trial.moments(random.uniform(0.2, 0.7))
    stamped = replace(track, t=track.t + random.choice([0.2, 0.5, 1.0]) * (track.t >= begin))
    return trial.spoiled(_until(trial, name, begin)).with_garbled(name, stamped)


def wxyz(trial: Trial, random: Random) -> Trial:
    """Quaternions in the order w x y z, of one device or of all."""
    return _attitudes(trial, random, lambda track: track.quat_xyzw[:, [3, 0, 1, 2]])


def identity(trial: Trial, random: Random) -> Trial:
    """No attitudes."""
    return _attitudes(trial, random, lambda track: np.tile(IDENTITY, (len(track), 1)))


def from_velocity(trial: Trial, random: Random) -> Trial:
    """Attitudes that were computed from where the track goes."""
    return _attitudes(trial, random, _headings)


def _attitudes(trial: Trial, random: Random, of: Callable[[Track], Array]) -> Trial:
    for name in trial.moving if random.random() < 0.7 else [_anybody(trial, random)]:
        track = trial.recording.tracks[name]
        trial = trial.with_garbled(name, replace(track, quat_xyzw=of(track)))
    return trial


def _headings(track: Track) -> Array:
    step = np.diff(track.position[:, :2], axis=0, append=track.position[-1:, :2])
    if len(step) > 1:
        step[-1] = step[-2]
    return yaw_quaternions(np.arctan2(step[:, 1], step[:, 0]))


# ---- drawing ----


def _anybody(trial: Trial, random: Random) -> str:
    """Any device that moves, the reference too."""
    return str(random.choice(trial.moving))


def _somebody(trial: Trial, random: Random) -> str:
    """Any device that moves but the first."""
    return str(random.choice(trial.moving[1:]))


def _aside(random: Random, length: float) -> Array:
    """(3,) m in the plane, to any side."""
    way = random.uniform(-np.pi, np.pi)
    return length * np.array([np.cos(way), np.sin(way), 0.0])


def _detour(random: Random, rows: Mask) -> Array:
    """(n,) m: one detour for these ranges, which fluctuates as the simulation's do; 0 for others."""
    length = SHORTEST_DETOUR_M + random.exponential(random.choice([0.2, 0.7, 1.7]))
    flutter = np.exp(DETOUR_FLUCTUATION * random.standard_normal(len(rows)) - 0.5 * DETOUR_FLUCTUATION**2)
    return np.where(rows, length * flutter, 0.0)


def _until(trial: Trial, name: str, t: float) -> Mask:
    """(n,) a device's ranges before a moment (s)."""
    return np.asarray(trial.of_device(name) & (trial.recording.ranges.t < t))


def _rows(track: Track, rows: slice) -> Track:
    return Track(track.t[rows], track.position[rows], track.quat_xyzw[rows])
