"""What happens to devices while people walk: SLAM that slides, jumps or sees the cabin, restarts, swapped radios.

A fault is made of a simulated walk of four: either a device's own track is changed and the truth stays, or the truth is
moved, ranges are measured anew (each with the error that it had), and SLAM does not see it. Truth is told in the frame
of those about the reference, so that people in a train who see its cabin are at fault where the reference stands
outside. How bad it is, and to which side, hangs on the seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from experiments.common.live import Call
from synchronizar.arrays import Array, Mask
from synchronizar.data.track import Track
from synchronizar.geometry import apply_frames
from synchronizar.quaternions import IDENTITY, multiply_quaternions, yaw_quaternions
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

REFERENCE, ONE, TWO = "phone0", "phone1", ("phone2", "phone3")
SECONDS, BEGIN = 75.0, 30.0
LASTS_S = 10.0
SPEEDS = (0.2, 0.4, 0.6, 1.0)
JUMPS_M = (0.5, 1.0, 2.0, 5.0)
STOREYS_M = (3.0, 5.0, 7.0, 10.0)
TRAIN_M_S = (1.0, 3.0)


@dataclass(frozen=True)
class Fault:
    """A walk with a fault."""

    simulation: Simulation
    """With the recording as it comes; truth by the rows of the recording's tracks."""
    faulty: tuple[str, ...] = ()
    begin: float = BEGIN
    """s, range clock."""
    end: float = BEGIN
    """s: from then on all is right again, be it in another frame."""
    arrivals: Mapping[str, Array] = field(default_factory=dict)
    """When poses come, of users whose stamps do not say."""
    calls: tuple[tuple[float, Call], ...] = ()
    """What the application tells the estimator, and when."""


def scene_of(seed: int, users: int = 4) -> Scene:
    """The walk that a fault is made in: SLAM drifts a little, but not in heading, which would turn the common frame."""
    return Scene(users=users, seconds=SECONDS, seed=seed, drift_m_per_sqrt_s=0.01)


def fault_of(kind: str, seed: int) -> Fault:
    """A fault of one of KINDS."""
    simulation = simulate(scene_of(seed))
    return KINDS[kind](simulation, seed, np.random.default_rng([seed, *kind.encode()]))


def in_frames(track: Track, frames: Array) -> Track:
    """Each pose as seen from another frame: `frames` (n, 4) x, y, z, yaw are new_from_old."""
    quat = multiply_quaternions(yaw_quaternions(frames[:, 3]), track.quat_xyzw)
    return replace(track, position=apply_frames(frames, track.position), quat_xyzw=quat)


def sliding(t: Array, velocity: Array, begin: float, end: float) -> Array:
    """(n, 4): a shift that grows at `velocity` (3,) m/s between two times, then stays."""
    out = np.zeros((len(t), 4))
    out[:, :3] = np.clip(t - begin, 0.0, end - begin)[:, None] * velocity
    return out


def jumped(track: Track, when: Mask, shift: Array, turn: float) -> Array:
    """(n, 4): what SLAM's frame is turned by about the device's first place of `when`, and shifted, at these poses."""
    out = np.zeros((len(track), 4))
    about = track.position[np.flatnonzero(when)[0]]
    turned = apply_frames(np.array([[0.0, 0.0, 0.0, turn]]), about[None])[0]
    out[when] = np.append(about + shift - turned, turn)
    return out


def with_track(simulation: Simulation, name: str, track: Track) -> Simulation:
    """One device's own track instead of what it was."""
    recording = simulation.recording
    return replace(simulation, recording=replace(recording, tracks={**recording.tracks, name: track}))


def with_truth_moved(simulation: Simulation, frames: Mapping[str, Array]) -> Simulation:
    """Users carried off by `frames` (n, 4), unseen by SLAM; each range keeps its error."""
    truth = {
        name: in_frames(track, frames[name]) if name in frames else track for name, track in simulation.truth.items()
    }
    moved, recording = replace(simulation, truth=truth), simulation.recording
    longer = simulation.range_errors() - moved.range_errors()
    ranges = replace(recording.ranges, distance=recording.ranges.distance + longer)
    return replace(moved, recording=replace(recording, ranges=ranges))


def _aside(random: np.random.Generator, length: float) -> Array:
    """(3,) m in the plane, to any side."""
    way = random.uniform(-np.pi, np.pi)
    return length * np.array([np.cos(way), np.sin(way), 0.0])


def _slide(who: str, speed: float | None = None) -> Callable[..., Fault]:
    def make(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
        track, end = simulation.recording.tracks[who], BEGIN + LASTS_S
        velocity = _aside(random, speed or SPEEDS[seed % len(SPEEDS)])
        slid = in_frames(track, sliding(track.t, velocity, BEGIN, end))
        return Fault(with_track(simulation, who, slid), (who,), BEGIN, end)

    return make


def _jump(who: str, attitude: bool = True) -> Callable[..., Fault]:
    def make(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
        track = simulation.recording.tracks[who]
        shift, turn = _aside(random, JUMPS_M[seed % len(JUMPS_M)]), random.uniform(-np.pi, np.pi)
        frames = jumped(track, track.t >= BEGIN, shift, turn if attitude else turn * (seed % 2))
        off = in_frames(track, frames)
        if not attitude:
            off = replace(off, quat_xyzw=np.tile(IDENTITY, (len(off), 1)))
        return Fault(with_track(simulation, who, off), (who,))

    return make


def _train(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
    """Two see the cabin of a train that pulls out and stops; the others stand on the platform."""
    velocity, end = _aside(random, TRAIN_M_S[seed % len(TRAIN_M_S)]), BEGIN + LASTS_S
    carried = {name: sliding(simulation.truth[name].t, velocity, BEGIN, end) for name in TWO}
    return Fault(with_truth_moved(simulation, carried), TWO, BEGIN, end)


def _all_aboard(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
    """All are in the train and see the world go by: nobody is at fault. So near that no scale makes a common error."""
    velocity, end = _aside(random, TRAIN_M_S[seed % len(TRAIN_M_S)]), BEGIN + LASTS_S
    out = simulation
    for name, track in simulation.recording.tracks.items():
        lay = out.world_from_user[name]
        own = sliding(track.t, replace(lay, x=0.0, y=0.0, z=0.0).inverse() @ velocity, BEGIN, end)
        out = with_track(out, name, in_frames(track, own))
    carried = {name: sliding(true.t, velocity, BEGIN, end) for name, true in out.truth.items()}
    return Fault(with_truth_moved(out, carried), (), BEGIN, end)


def _lift(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
    """One goes up or down; its SLAM sees the lift."""
    speed = STOREYS_M[seed % len(STOREYS_M)] / LASTS_S * random.choice([-1.0, 1.0])
    carried = sliding(simulation.truth[ONE].t, np.array([0.0, 0.0, speed]), BEGIN, BEGIN + LASTS_S)
    return Fault(with_truth_moved(simulation, {ONE: carried}), (ONE,), BEGIN, BEGIN + LASTS_S)


def _session(announced: bool) -> Callable[..., Fault]:
    def make(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
        track = simulation.recording.tracks[ONE]
        end = BEGIN + 2.0 + seed % 4
        after = track.t >= end
        first = track.position[np.flatnonzero(after)[0]]
        anew = in_frames(track, jumped(track, after, -first, random.uniform(-np.pi, np.pi)))
        kept = np.flatnonzero(after | (track.t < BEGIN))
        out = with_track(simulation, ONE, Track(anew.t[kept], anew.position[kept], anew.quat_xyzw[kept]))
        true = simulation.truth[ONE]
        seen = Track(true.t[kept], true.position[kept], true.quat_xyzw[kept])
        out = replace(out, truth={**out.truth, ONE: seen})
        calls: tuple[tuple[float, Call], ...] = ()
        if announced:
            calls = ((BEGIN, lambda e: e.lost_tracking(ONE)), (end - 0.01, lambda e: e.new_session(ONE)))
        return Fault(out, (ONE,), BEGIN, end, calls=calls)

    return make


def _two_maps(simulation: Simulation, seed: int, random: np.random.Generator) -> Fault:
    """SLAM takes one place for another and back, three times, each for 2 s."""
    track = simulation.recording.tracks[ONE]
    after = track.t - BEGIN
    other = (after >= 0.0) & (after < 10.0) & (after % 4.0 < 2.0)
    shift = _aside(random, JUMPS_M[1 + seed % 3])
    off = in_frames(track, jumped(track, other, shift, random.uniform(-np.pi, np.pi)))
    return Fault(with_track(simulation, ONE, off), (ONE,), BEGIN, BEGIN + LASTS_S)


def _frozen(simulation: Simulation, _: int, random: np.random.Generator) -> Fault:
    """The pose of a moment repeated for 6 s, then right again."""
    track, end = simulation.recording.tracks[ONE], BEGIN + 6.0
    row = np.arange(len(track))
    row[(track.t >= BEGIN) & (track.t < end)] = np.searchsorted(track.t, BEGIN + random.uniform(-0.1, 0.1))
    held = replace(track, position=track.position[row], quat_xyzw=track.quat_xyzw[row])
    return Fault(with_track(simulation, ONE, held), (ONE,), BEGIN, end)


def _swapped(simulation: Simulation, _: int, __: np.random.Generator) -> Fault:
    """Two wear each other's radio for a while."""
    end, recording = BEGIN + LASTS_S, simulation.recording
    other = np.arange(len(recording.users), dtype=np.int32)
    pair = [recording.index(name) for name in TWO]
    other[pair] = pair[::-1]
    r = recording.ranges
    then = (r.t >= BEGIN) & (r.t < end)
    ranges = replace(r, a=np.where(then, other[r.a], r.a), b=np.where(then, other[r.b], r.b))
    return Fault(replace(simulation, recording=replace(recording, ranges=ranges)), TWO, BEGIN, end)


def _clock(simulation: Simulation, seed: int, _: np.random.Generator) -> Fault:
    """A device's clock is put forward; its poses come as before."""
    track = simulation.recording.tracks[ONE]
    stamped = replace(track, t=track.t + (0.2, 0.5, 1.0, 3600.0)[seed % 4] * (track.t >= BEGIN))
    return Fault(with_track(simulation, ONE, stamped), (ONE,), arrivals={ONE: track.t})


def _stray(simulation: Simulation, seed: int, _: np.random.Generator) -> Fault:
    """One pose more, stamped a day ahead or 0."""
    track, stamp = simulation.recording.tracks[ONE], (86400.0, 0.0)[seed % 2]
    row = int(np.searchsorted(track.t, BEGIN))
    place, quat = track.position[row], track.quat_xyzw[row]
    call = (BEGIN, lambda e: e.add_pose(ONE, stamp, place, quat))
    return Fault(simulation, (ONE,), calls=(call,))


KINDS: dict[str, Callable[[Simulation, int, np.random.Generator], Fault]] = {
    "none": lambda simulation, _, __: Fault(simulation),
    "slide": _slide(ONE),
    "slide, reference": _slide(REFERENCE),
    "jump": _jump(ONE),
    "jump, reference": _jump(REFERENCE),
    "jump, no attitude": _jump(ONE, attitude=False),
    "train": _train,
    "train, world seen by one": _slide(ONE, speed=5.0),
    "train, all see the world": _all_aboard,
    "lift": _lift,
    "new session": _session(announced=False),
    "new session, announced": _session(announced=True),
    "two maps": _two_maps,
    "frozen": _frozen,
    "swapped radios": _swapped,
    "clock step": _clock,
    "stray stamp": _stray,
}
"""A fault of a simulated walk, its seed and what draws the rest."""
