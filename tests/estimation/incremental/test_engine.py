from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from experiments.common.full_oracle import common_from_world
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.replay import in_time
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.quaternions import yaw_quaternion
from synchronizar.simulation.simulate import Scene, Simulation, simulate

NOISY = Scene(
    users=3,
    seconds=12.0,
    rate_hz=8.0,
    sigma=0.1,
    late_share=0.1,
    bias_sigma=0.05,
    clock_offset_sigma=0.05,
    scale_sigma=0.05,
    drift_m_per_sqrt_s=0.01,
    drift_rad_per_sqrt_s=0.005,
)
CLEAN = Scene(users=3, seconds=18.0, rate_hz=8.0, seed=1)
SHORT = Parameters().changed(incremental={"window": 4.0}, search={"first_stretch": 8.0})
TICK = 0.1  # s
A_SOLVE = 3.2
"""s: some thirty portions, one each tick."""
REFERENCE = "phone0"

Add = Callable[[Engine], None]
Message = tuple[float, Add]


@dataclass
class Assessment:
    """What an engine told while it was fed."""

    engine: Engine
    t: list[float] = field(default_factory=list)
    states: list[list[State]] = field(default_factory=list)
    frames: list[list[YawFrame | None]] = field(default_factory=list)
    events: list[list[str]] = field(default_factory=list)
    kept: list[tuple[int, int]] = field(default_factory=list)
    """How many poses of the first user and how many ranges."""

    def look(self, now: float, last: bool = False) -> None:
        """Advance, to the end where it is the last time, and note what is told then."""
        everybody = range(len(self.engine.users))
        self.events.append(self.engine.complete(now) if last else self.engine.advance(now))
        self.t.append(now)
        self.states.append([self.engine.state(u) for u in everybody])
        self.frames.append([self.engine.frame(u) for u in everybody])
        self.kept.append((len(self.engine.stream._poses[0]), len(self.engine.stream._ranges)))

    def first(self, user: int, state: State) -> float:
        """When a user first was in a state."""
        return next(t for t, states in zip(self.t, self.states, strict=True) if states[user] is state)


def messages(recording: Recording) -> Iterator[Message]:
    """Everything that was measured and when it came: at once."""

    def pose(name: str, n: int) -> Add:
        track = recording.tracks[name]
        return lambda e: e.add_pose(name, float(track.t[n]), track.position[n], track.quat_xyzw[n])

    def measured(n: int) -> Add:
        r, names = recording.ranges, [user.name for user in recording.users]
        t, a, b = float(r.t[n]), names[r.a[n]], names[r.b[n]]
        return lambda e: e.add_range(t, a, b, float(r.distance[n]))

    for name, track in recording.tracks.items():
        for n, t in enumerate(track.t.tolist()):
            yield t, pose(name, n)
    for n, t in enumerate(recording.ranges.t.tolist()):
        yield t, measured(n)


def feed(recording: Recording, arriving: Iterable[Message], model: Parameters | None = None) -> Assessment:
    """Messages in the order in which they come; a look every tenth of a second, and one when all is long over."""
    engine = Engine(recording.users, REFERENCE, model)
    told = Assessment(engine)
    in_order = sorted(arriving, key=lambda message: message[0])
    ticks = TICK * np.arange(np.ceil(in_order[0][0] / TICK) + 1, np.floor(in_order[-1][0] / TICK) + 1)
    rest = iter(in_order)
    coming: Message | None = next(rest)
    for now in [*ticks.tolist(), in_order[-1][0] + 2.0]:
        while coming is not None and coming[0] < now:
            coming[1](engine)
            coming = next(rest, None)
        told.look(now, last=now > in_order[-1][0])
    return told


@cache
def simulated(scene: Scene) -> Simulation:
    return simulate(scene)


@cache
def walked(scene: Scene, model: Parameters | None = None) -> Assessment:
    recording = simulated(scene).recording
    return feed(recording, messages(recording), model)


def true_frame(simulation: Simulation, name: str) -> YawFrame:
    """`common_from_user` at the last pose."""
    return common_from_world(simulation, REFERENCE) @ simulation.world_from_user[name]


def errors(told: Assessment, simulation: Simulation) -> Array:
    """(k - 1, 4) x, y, z (m), yaw (rad) at the last poses of all but the reference: what was found minus the truth."""
    out = []
    for u, user in enumerate(simulation.recording.users[1:], 1):
        frame, true = told.engine.frame(u), true_frame(simulation, user.name)
        assert frame is not None
        last = simulation.recording.tracks[user.name].position[-1]
        out.append([*(frame @ last - true @ last), wrap_angle(frame.yaw - true.yaw)])
    return np.array(out)


def sigmas(told: Assessment) -> Array:
    """(k - 1, 4) 1 sigma of all last poses but the reference's: x, y (both along the longer axis), z (m), yaw (rad)."""
    assert told.engine.solution is not None
    covariances = told.engine.solution.told.covariances[1:]
    plane = np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1:]
    return np.sqrt(np.column_stack([plane, plane, covariances[:, 2, 2], covariances[:, 3, 3]]))


# ---- what is told before anything is known ----


def test_before_any_range_nobody_but_the_reference_has_a_placement() -> None:
    recording = simulated(NOISY).recording
    silent = replace(recording, ranges=recording.ranges.select(np.zeros(0, dtype=np.intp)))
    told = feed(silent, messages(silent))
    engine = told.engine
    assert all(states == [State.REGISTERED, State.DISCONNECTED, State.DISCONNECTED] for states in told.states)
    assert all(frames[1:] == [None, None] for frames in told.frames)
    assert [engine.is_registered(u) for u in (1, 2)] == [False, False]
    assert [engine.progress(u) for u in range(3)] == [1.0, 0.0, 0.0]
    assert not any(told.events)
    with pytest.raises(ValueError, match="nothing was solved"):
        engine.registration()


@pytest.mark.parametrize("name", ["nobody", "radio0"])
def test_the_reference_must_be_somebody_who_moves(name: str) -> None:
    users = simulated(replace(NOISY, static_radios=1)).recording.users
    with pytest.raises(KeyError):
        Engine(users, name)


# ---- what is known at the end ----


@pytest.mark.parametrize("seed", range(3))
def test_at_the_end_all_are_registered_near_the_truth(seed: int) -> None:
    scene = replace(NOISY, seed=seed)
    told = walked(scene)
    assert told.states[-1] == [State.REGISTERED] * 3
    assert all(told.engine.is_registered(u) for u in range(3))
    assert [told.engine.progress(u) for u in range(3)] == [1.0] * 3
    error = errors(told, simulated(scene))
    assert (np.abs(error) < 4.0 * sigmas(told)).all()
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.6


def test_at_the_end_it_says_what_the_batch_solve_says() -> None:
    """Within a tenth of a sigma, heights within three; which ranges are late has a second answer now and then."""
    apart = []
    for seed in range(4):
        scene = replace(NOISY, seed=seed)
        told, recording = walked(scene), simulated(scene).recording
        batch = register(recording, REFERENCE)
        for u, sigma in enumerate(sigmas(told), 1):
            name = recording.users[u].name
            found, expected = told.engine.frame(u), batch.users[name].common_from_user
            last = recording.tracks[name].position[-1]
            assert found is not None
            assert expected is not None
            away = [*(found @ last - expected @ last), wrap_angle(found.yaw - expected.yaw)]
            apart.append(np.abs(away) / sigma)
            assert told.engine.state(u) is batch.users[name].state
    assert (np.array(apart) < 1.0).all()
    assert (np.array(apart) < [0.1, 0.1, 0.3, 0.1]).all(axis=1).sum() >= 6


def test_where_a_solution_anchors_its_end_is_where_the_next_window_would_begin() -> None:
    engine = walked(NOISY).engine
    solution, memory = engine.solution, engine.memory
    assert solution is not None
    last = memory.checkpoints[-1]
    anchor = solution.anchor_at(memory.gauge, float(last.begin[memory.gauge]))
    np.testing.assert_allclose(anchor, last.common, atol=1e-6)
    earlier = solution.anchor_at(memory.gauge, float(last.begin[memory.gauge]) - 2.0)
    assert 0.1 < np.hypot(*(earlier - anchor)[:2]) < 4.0  # two seconds of walking


def test_a_frame_lays_poses_where_slam_followed_since_has_them() -> None:
    told = walked(NOISY)
    solution, random = told.engine.solution, np.random.default_rng(1)
    assert solution is not None
    for u in (1, 2):
        frame, position = told.engine.frame(u), random.normal(0.0, 3.0, 3)
        quat = random.normal(size=4)
        quat /= np.linalg.norm(quat)
        assert frame is not None
        place, attitude = solution.pose(u, position, quat)
        np.testing.assert_allclose(place, frame @ position, atol=1e-9)
        expected = YawFrame(yaw=frame.yaw).rotate_quaternions(quat)
        np.testing.assert_allclose(attitude, expected * np.sign(attitude @ expected), atol=1e-9)
    # A user whose SLAM stands at its own origin is where its frame is.
    place, attitude = solution.pose(0, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    reference = told.engine.frame(0)
    assert reference is not None
    np.testing.assert_allclose(place, reference.translation, atol=1e-9)
    np.testing.assert_allclose(attitude, yaw_quaternion(reference.yaw), atol=1e-9)


# ---- streams as they are ----


def test_nothing_is_seen_ahead_of_its_time() -> None:
    recording, whole = simulated(NOISY).recording, walked(NOISY)
    end = 0.5 * NOISY.seconds
    part = feed(recording, [message for message in messages(recording) if message[0] < end])
    n = len(part.t) - 1  # but for the look when all is over
    assert n > 5.0 * end
    assert part.t[:n] == whole.t[:n]
    assert part.states[:n] == whole.states[:n]
    assert part.events[:n] == whole.events[:n]
    assert part.frames[:n] == whole.frames[:n]


def test_what_comes_twice_counts_once() -> None:
    recording, once = simulated(NOISY).recording, walked(NOISY)
    all_messages, random = list(messages(recording)), np.random.default_rng(2)
    again = [all_messages[n] for n in random.choice(len(all_messages), len(all_messages) // 5, replace=False)]
    twice = feed(recording, [*all_messages, *again])
    assert len(twice.engine.stream._ranges) > len(recording.ranges)
    assert twice.states == once.states
    assert twice.frames == once.frames
    assert twice.engine.stream.faults == 0


def test_late_and_shuffled_and_thinned_messages_still_register() -> None:
    """Up to half a second late, a tenth twice, three of ten ranges and poses lost."""
    recording, random = simulated(NOISY).recording, np.random.default_rng(0)
    arriving = []
    for t, add in messages(recording):
        if random.uniform() < 0.7:
            times = 2 if random.uniform() < 0.1 else 1
            arriving += [(t + random.uniform(0.0, 0.5), add) for _ in range(times)]
    told = feed(recording, arriving)
    assert told.states[-1] == [State.REGISTERED] * 3
    error = errors(told, simulated(NOISY))
    assert (np.abs(error) < 4.0 * sigmas(told)).all()
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.6


# ---- who comes late, who leaves ----

JOINING = replace(NOISY, seconds=18.0, late_joiners=1, seed=4)


def test_who_comes_late_joins_and_moves_the_others_by_no_more_than_they_may_be_off() -> None:
    recording, told = simulated(JOINING).recording, walked(JOINING, SHORT)
    without = recording.ranges.select((recording.ranges.a != 2) & (recording.ranges.b != 2))
    alone = feed(recording, messages(replace(recording, ranges=without)), SHORT)
    assert told.first(2, State.REGISTERED) > 0.5 * JOINING.seconds
    assert told.first(1, State.REGISTERED) < 0.5 * JOINING.seconds
    assert told.states[-1] == [State.REGISTERED] * 3
    assert alone.states[-1][2] is State.DISCONNECTED
    assert alone.frames[-1][2] is None
    error = errors(told, simulated(JOINING))
    assert (np.abs(error) < 4.0 * sigmas(told)).all()
    # Up to when it came both know the same; afterwards the one knows more.
    came = sum(t < 0.5 * JOINING.seconds for t in told.t)
    assert told.frames[:came] == alone.frames[:came]
    first, n = sigmas(alone)[0], recording.tracks["phone1"].position[-1]
    together, apart = told.engine.frame(1), alone.engine.frame(1)
    assert together is not None
    assert apart is not None
    assert (np.abs(together @ n - apart @ n) < 2.5 * first[:3]).all()
    assert abs(wrap_angle(together.yaw - apart.yaw)) < 2.5 * first[3]


@cache
def test_two_groups_become_one_where_a_chain_of_ranges_ties_them() -> None:
    """Two pairs range among themselves; from 8 s on one of each hears one of the other."""
    simulation = simulated(replace(CLEAN, users=4))
    recording, r = simulation.recording, simulation.recording.ranges
    across = (r.a < 2) != (r.b < 2)
    tied = (np.minimum(r.a, r.b) == 1) & (np.maximum(r.a, r.b) == 2) & (r.t > 8.0)
    recording = replace(recording, ranges=r.select(~across | tied))
    told = feed(recording, messages(recording))
    before = [states for states, t in zip(told.states, told.t, strict=True) if t < 8.0]
    assert all(states[2] is State.DISCONNECTED is states[3] for states in before)
    assert told.first(2, State.REGISTERED) < 18.0
    assert told.first(3, State.REGISTERED) < 18.0
    assert told.states[-1] == [State.REGISTERED] * 4
    assert (np.abs(errors(told, simulation)) < 4.0 * sigmas(told)).all()


def left() -> Assessment:
    """The last user ranges no more after 10 s; its SLAM goes on."""
    recording = simulated(CLEAN).recording
    r = recording.ranges
    recording = replace(recording, ranges=r.select((r.t < 10.0) | ((r.a != 2) & (r.b != 2))))
    return feed(recording, messages(recording), SHORT)


def test_who_leaves_is_not_called_registered_without_a_frame_and_others_stay() -> None:
    told = left()
    assert told.first(2, State.REGISTERED) < 10.0
    for states, frames in zip(told.states, told.frames, strict=True):
        assert states[2] is not State.REGISTERED or frames[2] is not None
    assert told.states[-1] == [State.REGISTERED, State.REGISTERED, State.DISCONNECTED]
    went = next(t for t, events in zip(told.t, told.events, strict=True) if "phone2: disconnected" in " ".join(events))
    assert 10.0 < went < 10.0 + SHORT.incremental.window + 2.0 * A_SOLVE


def test_who_leaves_does_not_hold_the_window_back() -> None:
    assert left().kept[-1][0] < (SHORT.incremental.window + 1.0 + 2.0 * A_SOLVE) * CLEAN.track_rate_hz


# ---- a window that is shorter than the walk ----


def test_what_is_kept_does_not_grow_with_the_walk() -> None:
    told = walked(replace(CLEAN, seconds=30.0), SHORT)
    registered = max(told.first(u, State.REGISTERED) for u in (1, 2))
    optimum = registered + SHORT.integrity.proven_duration + SHORT.incremental.window + 2.0 * A_SOLVE
    poses, ranges = np.array([kept for kept, t in zip(told.kept, told.t, strict=True) if t > optimum]).T
    # The window, a second before it, the last solve at which it could begin, the one after, and what came since.
    seconds = SHORT.incremental.window + 1.0 + 3.0 * A_SOLVE
    assert len(poses) > 50
    assert poses.max() < seconds * CLEAN.track_rate_hz
    assert ranges.max() < seconds * 3 * CLEAN.round_hz
    assert len(told.engine.memory.checkpoints) < SHORT.search.first_stretch + SHORT.incremental.window + 5.0


def test_once_all_are_known_each_solve_is_spread_over_many_updates() -> None:
    recording = simulated(CLEAN).recording
    engine, solved = Engine(recording.users, REFERENCE), []
    for t, user, row in in_time(recording):
        if user < 0:
            r, names = recording.ranges, [u.name for u in recording.users]
            engine.add_range(t, names[r.a[row]], names[r.b[row]], float(r.distance[row]))
            if len(engine.memory.known) == 3:
                before = engine.solution
                engine.advance(t)
                solved.append(engine.solution is not before)
            else:
                engine.advance(t)
        else:
            track = recording.tracks[recording.users[user].name]
            engine.add_pose(recording.users[user].name, t, track.position[row], track.quat_xyzw[row])
    at = np.flatnonzero(solved)
    assert len(at) > 3
    assert 15 < np.diff(at).min() <= np.diff(at).max() < 45
    solution = engine.solution
    assert solution is not None
    assert solution.graph.measurements.t.max() < recording.ranges.t.max() - 0.2
    engine.complete(float(recording.ranges.t.max()))
    solution = engine.solution
    assert solution is not None
    assert solution.graph.measurements.t.max() > recording.ranges.t.max() - 0.1


def test_a_short_window_ends_about_where_the_whole_does() -> None:
    short, whole, simulation = walked(CLEAN, SHORT), walked(CLEAN), simulated(CLEAN)
    for u, sigma in enumerate(sigmas(short), 1):
        last = simulation.recording.tracks[f"phone{u}"].position[-1]
        found, expected = short.engine.frame(u), whole.engine.frame(u)
        assert found is not None
        assert expected is not None
        assert (np.abs(found @ last - expected @ last) < 1.5 * sigma[:3]).all()
        assert abs(wrap_angle(found.yaw - expected.yaw)) < 1.5 * sigma[3]
    assert (np.abs(errors(short, simulation)) < 4.0 * sigmas(short)).all()
    # What was carried is believed: four seconds by themselves would not tell as much.
    assert (sigmas(short) < 1.5 * sigmas(whole)).all()


@pytest.mark.parametrize("name", ["phone0", "phone1"])
def test_a_jump_in_height_is_forgotten_with_the_window_that_held_it(name: str) -> None:
    """SLAM rises by half a metre at 10 s and its user does not."""
    scene = replace(CLEAN, seconds=30.0)
    recording = simulated(scene).recording
    track = recording.tracks[name]
    track = replace(track, position=track.position + np.outer(track.t > 10.0, [0.0, 0.0, 0.5]))
    jumped = replace(recording, tracks={**recording.tracks, name: track})
    told, repaired = feed(jumped, messages(jumped), SHORT), walked(scene, SHORT)
    for u in range(3):
        heights = []
        for run, of in ((told, jumped), (repaired, recording)):
            frame = run.engine.frame(u)
            assert frame is not None
            heights.append((frame @ of.tracks[f"phone{u}"].position[-1])[2])
        assert abs(heights[0] - heights[1]) < 0.2


# ---- states and events ----


@pytest.mark.parametrize(
    "run",
    [lambda: walked(NOISY), lambda: walked(CLEAN, SHORT), lambda: walked(JOINING, SHORT), left],
    ids=["noisy", "windowed", "joining", "leaving"],
)
def test_every_change_of_state_is_an_event_and_nothing_else_is(run: Callable[[], Assessment]) -> None:
    told = run()
    users = told.engine.users
    before = [State.REGISTERED] + [State.DISCONNECTED] * (len(users) - 1)
    changes = 0
    for states, events in zip(told.states, told.events, strict=True):
        expected = {f"{u.name}: {new}" for u, old, new in zip(users, before, states, strict=True) if old is not new}
        assert {": ".join(event.split(": ")[:2]) for event in events} == expected
        assert len(events) == len(expected)
        changes += len(events)
        before = states
    assert changes >= 2 * (len(users) - 1)


@pytest.mark.parametrize(
    "run", [lambda: walked(NOISY), lambda: walked(JOINING, SHORT), left], ids=["noisy", "joining", "leaving"]
)
def test_whoever_is_registered_has_a_frame(run: Callable[[], Assessment]) -> None:
    told = run()
    for states, frames in zip(told.states, told.frames, strict=True):
        for state, frame in zip(states[1:], frames[1:], strict=True):
            assert state is not State.REGISTERED or frame is not None
            assert state is not State.DISCONNECTED or frame is None


def test_who_left_is_judged_anew_when_it_returns() -> None:
    """How long it had stayed in its place, and been registered, before it went says nothing of where it is now."""
    told = left()
    memory = told.engine.memory
    assert told.first(2, State.REGISTERED) < 10.0
    assert 2 not in memory.since
    assert 2 not in memory.steady
    assert 2 not in memory.registered
    assert 1 in memory.registered
