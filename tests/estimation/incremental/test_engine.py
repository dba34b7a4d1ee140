from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import pytest

from experiments.common.faults import sliding, with_truth_moved
from experiments.common.full_oracle import common_from_world
from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.told import registration_now, user_now
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.simulation.simulate import Scene, Simulation, simulate

NOISY = Scene(
    users=3,
    seconds=12.0,
    seed=3,
    rate_hz=8.0,
    sigma=0.1,
    late_share=0.1,
    bias_sigma=0.05,
    clock_offset_sigma=0.05,
    scale_sigma=0.05,
    drift_m_per_sqrt_s=0.01,
    drift_rad_per_sqrt_s=0.005,
)
CLEAN = Scene(users=2, seconds=16.0, rate_hz=8.0, seed=1)
SHORT = Parameters().changed(incremental={"window": 4.0}, search={"first_stretch": 8.0})
TICK = 0.1  # s
DAY = 86400.0

Add = Callable[[Engine], None]
Message = tuple[float, Add]


@dataclass
class Told:
    """What an engine told while it was fed."""

    engine: Engine
    t: list[float] = field(default_factory=list)
    states: list[list[State]] = field(default_factory=list)
    frames: list[list[YawFrame | None]] = field(default_factory=list)
    events: list[list[str]] = field(default_factory=list)
    kept: list[tuple[int, int, int]] = field(default_factory=list)
    """How many poses of the first user, ranges and variables' slots."""

    def look(self, now: float, last: bool = False) -> None:
        """Advance, to the end where it is the last time, and note what is told then."""
        engine = self.engine
        self.events.append(engine.complete(now) if last else engine.advance(now))
        users = [user_now(engine, u) for u in range(len(engine.users))]
        self.t.append(now)
        self.states.append([engine.state(u) for u in range(len(engine.users))])
        self.frames.append([user.common_from_user for user in users])
        stream = engine.roster.streams[0]
        assert stream is not None
        self.kept.append((len(stream), len(engine.log.rows), len(engine.following.tracking.follower.slots)))

    def first(self, user: int, state: State) -> float:
        """When a user first was in a state."""
        return next(t for t, states in zip(self.t, self.states, strict=True) if states[user] is state)


def messages(recording: Recording) -> list[Message]:
    """Everything that was measured and when it came: at once."""
    r, names = recording.ranges, sorted(recording.tracks)

    def pose(user: int, n: int) -> Add:
        track = recording.tracks[names[user]]
        return lambda e: e.add_pose(user, float(track.t[n]), track.position[n].tolist(), track.quat_xyzw[n].tolist())

    def measured(n: int) -> Add:
        return lambda e: e.add_range(float(r.t[n]), int(r.a[n]), int(r.b[n]), float(r.distance[n]))

    out = [
        (t, pose(names.index(name), n))
        for name, track in recording.tracks.items()
        for n, t in enumerate(track.t.tolist())
    ]
    return out + [(t, measured(n)) for n, t in enumerate(r.t.tolist())]


def feed(
    recording: Recording, arriving: list[Message], parameters: Parameters | None = None, known: int | None = None
) -> Told:
    """Messages in the order in which they come; a look every tenth of a second, and one when all is over.

    Only the first `known` users are there from the begin.
    """
    told = Told(Engine(recording.users[:known], 0, parameters))
    in_order = sorted(arriving, key=lambda message: message[0])
    end = in_order[-1][0]
    rest = iter([*in_order, (np.inf, lambda _: None)])
    t, add = next(rest)
    for now in [*(TICK * np.arange(1, np.floor(end / TICK) + 1)).tolist(), end + TICK]:
        while t < now:
            add(told.engine)
            t, add = next(rest)
        told.look(now, last=now > end)
    return told


@cache
def simulated(scene: Scene) -> Simulation:
    return simulate(scene)


@cache
def walked(scene: Scene, parameters: Parameters | None = None) -> Told:
    recording = simulated(scene).recording
    return feed(recording, messages(recording), parameters)


def errors(told: Told, simulation: Simulation) -> Array:
    """(k - 1, 4) x, y, z (m), yaw (rad) at the last poses of all but the reference: what was found minus the truth."""
    out = []
    for u, user in enumerate(simulation.recording.users[1:], 1):
        frame, true = (
            told.frames[-1][u],
            common_from_world(simulation, "phone0") @ simulation.world_from_user[user.name],
        )
        assert frame is not None
        last = simulation.recording.tracks[user.name].position[-1]
        out.append([*(frame @ last - true @ last), wrap_angle(frame.yaw - true.yaw)])
    return np.array(out)


def sigmas(told: Told) -> Array:
    """(k - 1, 4) 1 sigma of all but the reference: x, y (both along the longer axis), z (m), yaw (rad)."""
    out = []
    for standing in told.engine.roster.standings[1:]:
        assert standing.placed is not None
        covariance = standing.placed.covariance[:4, :4]
        plane = np.linalg.eigvalsh(covariance[:2, :2])[-1]
        out.append([plane, plane, covariance[2, 2], covariance[3, 3]])
    return np.sqrt(out)


# ---- what is told before anything is known ----


def test_before_any_range_nobody_but_the_reference_has_a_placement() -> None:
    recording = simulated(NOISY).recording
    silent = replace(recording, ranges=recording.ranges.select(np.zeros(0, dtype=np.intp)))
    told = feed(silent, messages(silent))
    assert all(states == [State.REGISTERED, State.DISCONNECTED, State.DISCONNECTED] for states in told.states)
    assert all(frames == [None] * 3 for frames in told.frames)
    assert not any(told.events)
    assert not told.engine.solved
    now = registration_now(told.engine)
    assert all(user.state is State.DISCONNECTED and user.progress == 0.0 for user in now.users.values())


def test_the_reference_is_where_its_own_slam_has_it_before_anything_is_solved() -> None:
    engine = Engine(simulated(NOISY).recording.users, 0)
    engine.add_pose(0, 0.0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.6, 0.8))
    place, attitude = engine.pose(0, np.array([1.0, 2.0, 3.0]), np.array([0.0, 0.0, 0.6, 0.8]))  # type: ignore[misc]
    np.testing.assert_allclose(place, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(attitude, [0.0, 0.0, 0.6, 0.8])
    assert engine.pose(1, np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])) is None


def test_an_engine_that_is_told_nothing_but_the_time_says_nothing() -> None:
    engine = Engine(simulated(NOISY).recording.users, 0)
    assert [engine.advance(t) for t in (0.0, 1.0, 1.0, 0.5, 100.0)] == [[]] * 5
    assert engine.complete(101.0) == []


# ---- what is known at the end ----


@pytest.mark.parametrize("seed", [1, 3])
def test_at_the_end_all_are_registered_near_the_truth(seed: int) -> None:
    scene = replace(NOISY, seed=seed)
    told = walked(scene)
    assert told.states[-1] == [State.REGISTERED] * 3
    assert [user.progress for user in registration_now(told.engine).users.values()] == [1.0] * 3
    error = errors(told, simulated(scene))
    assert (np.abs(error) < 4.0 * sigmas(told)).all()
    assert np.hypot(error[:, 0], error[:, 1]).max() < 0.6


@pytest.mark.parametrize("seed", [1, 3])
def test_at_the_end_it_says_about_what_the_batch_solve_says(seed: int) -> None:
    scene = replace(NOISY, seed=seed)
    told, recording = walked(scene), simulated(scene).recording
    batch = register(recording, "phone0")
    for u, sigma in enumerate(sigmas(told), 1):
        name = recording.users[u].name
        found, expected = told.frames[-1][u], batch.users[name].common_from_user
        last = recording.tracks[name].position[-1]
        assert found is not None
        assert expected is not None
        away = [*(found @ last - expected @ last), wrap_angle(found.yaw - expected.yaw)]
        assert (np.abs(away) < 2.0 * sigma).all()
        assert told.engine.state(u) is batch.users[name].state


def test_a_radio_that_is_far_off_keeps_its_bias_while_it_is_followed() -> None:
    """0.9 m is 18 sigmas of the usual prior: a search finds it, and what follows must not pull it back."""
    scene = Scene(users=4, seconds=24.0, rate_hz=8.0, seed=2)
    simulation = simulated(scene)
    ranges = simulation.recording.ranges
    longer = replace(ranges, distance=ranges.distance + 0.9 * ((ranges.a == 0) | (ranges.b == 0)))
    recording = replace(simulation.recording, ranges=longer)
    told = feed(recording, messages(recording))
    assert told.states[-1] == [State.REGISTERED] * 4
    assert user_now(told.engine, 0).range_bias == pytest.approx(0.9, abs=0.15)
    assert (np.linalg.norm(errors(told, simulation)[:, :2], axis=1) < 0.2).all()


def test_a_pose_is_where_the_frame_of_its_user_has_it() -> None:
    told, random = walked(NOISY), np.random.default_rng(1)
    for u in range(3):
        frame, position, quat = told.frames[-1][u], random.normal(0.0, 3.0, 3), random.normal(size=4)
        quat /= np.linalg.norm(quat)
        placed = told.engine.pose(u, position, quat)
        assert frame is not None
        assert placed is not None
        np.testing.assert_allclose(placed[0], frame @ position, atol=1e-9)
        expected = YawFrame(yaw=frame.yaw).rotate_quaternions(quat)
        np.testing.assert_allclose(placed[1], expected * np.sign(placed[1] @ expected), atol=1e-9)


# ---- streams as they are ----


def test_nothing_is_seen_ahead_of_its_time() -> None:
    recording, whole = simulated(NOISY).recording, walked(NOISY)
    end = 0.5 * NOISY.seconds
    part = feed(recording, [message for message in messages(recording) if message[0] < end])
    n = len(part.t) - 1  # but for the look when all is over
    assert n > 5.0 * end
    assert part.states[:n] == whole.states[:n]
    assert part.events[:n] == whole.events[:n]
    assert part.frames[:n] == whole.frames[:n]


def test_a_search_that_is_nearly_decided_is_soon_repeated() -> None:
    """Two people are looked for every half second, and sooner where the last search says that the next may do."""
    recording = simulated(CLEAN).recording
    engine, begun = Engine(recording.users, 0), []
    rest = iter(sorted(messages(recording), key=lambda message: message[0]))
    t, add = next(rest)
    for now in (TICK * np.arange(1, 80)).tolist():
        while t < now:
            add(engine)
            t, add = next(rest)
        before, progress = engine.schedule.searched, engine.roster.standings[1].progress
        engine.advance(now)
        if engine.schedule.searched > before > 0.0:
            begun.append((now - before, progress))
        if engine.state(1) is State.REGISTERED:
            break
    m = engine.parameters.incremental
    assert engine.state(1) is State.REGISTERED
    assert min(after for after, _ in begun) > m.search_interval_near - 1e-6
    assert max(after for after, _ in begun) < m.search_interval + m.search_interval_near + 1.5 * TICK
    assert all(progress > 0.5 for after, progress in begun if after < m.search_interval - 1e-6)
    assert any(after < m.search_interval - 1e-6 for after, _ in begun)


def test_two_runs_are_the_same_to_the_last_bit() -> None:
    recording, once = simulated(NOISY).recording, walked(NOISY)
    again = feed(recording, messages(recording))
    assert again.events == once.events
    assert again.frames == once.frames
    ours, theirs = registration_now(again.engine), registration_now(once.engine)
    for name, user in ours.users.items():
        assert np.asarray(user.covariance).tobytes() == np.asarray(theirs.users[name].covariance).tobytes()
    assert ours.ranges.weight.tobytes() == theirs.ranges.weight.tobytes()
    assert ours.ranges.residual.tobytes() == theirs.ranges.residual.tobytes()


def test_what_comes_twice_counts_once() -> None:
    recording, once = simulated(NOISY).recording, walked(NOISY)
    all_messages, random = messages(recording), np.random.default_rng(2)
    again = [all_messages[n] for n in random.choice(len(all_messages), len(all_messages) // 5, replace=False)]
    twice = feed(recording, [*all_messages, *again])
    assert twice.states == once.states
    assert twice.frames == once.frames


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


# ---- stamps astray ----


@pytest.mark.parametrize("away", [DAY, -DAY])
def test_one_range_stamped_a_day_away_changes_nothing(away: float) -> None:
    recording, plain = simulated(CLEAN).recording, walked(CLEAN)
    told = feed(recording, [*messages(recording), (6.0, lambda e: e.add_range(6.0 + away, 0, 1, 2.0))])
    assert told.engine.roster.now == plain.engine.roster.now
    assert told.states == plain.states
    assert told.frames == plain.frames


@pytest.mark.parametrize("away", [DAY, -DAY])
def test_one_time_a_day_away_does_not_make_it_that_day(away: float) -> None:
    def stray(engine: Engine) -> None:
        engine.advance(7.05 + away)

    recording, plain = simulated(CLEAN).recording, walked(CLEAN)
    told = feed(recording, [*messages(recording), (7.05, stray)])
    assert told.engine.roster.now == plain.engine.roster.now
    assert told.states == plain.states


def test_first_ranges_stamped_astray_do_not_begin_anything() -> None:
    """A radio that stamps its first ranges since it was switched on, and the others since 1970."""
    recording, plain = simulated(CLEAN).recording, walked(CLEAN)
    early: list[Message] = [(0.0, lambda e, n=n: e.add_range(-DAY + n, 0, 1, 2.0)) for n in range(2)]  # type: ignore[misc]
    told = feed(recording, [*early, *messages(recording)])
    assert told.engine.following.tracking.origin == plain.engine.following.tracking.origin
    assert told.engine.roster.standings[1].since == plain.engine.roster.standings[1].since
    assert told.states[-1] == plain.states[-1]


def test_time_that_goes_on_after_a_pause_is_followed() -> None:
    recording = simulated(replace(CLEAN, seed=2)).recording
    engine = feed(recording, messages(recording)[::2], SHORT).engine
    assert engine.state(1) is State.REGISTERED
    for n in range(10):
        engine.advance(200.0 + n * TICK)
    assert engine.roster.now == pytest.approx(200.9)
    assert engine.state(1) is State.DISCONNECTED
    assert not engine.following.tracking.members


# ---- who comes late, who leaves ----

JOINING = replace(CLEAN, users=3, late_joiners=1)


def test_who_comes_late_joins_those_who_are_there() -> None:
    told = walked(JOINING, SHORT)
    assert told.first(1, State.REGISTERED) < 0.5 * JOINING.seconds < told.first(2, State.REGISTERED)
    assert told.states[-1] == [State.REGISTERED] * 3
    error = errors(told, simulated(JOINING))
    assert (np.abs(error) < 4.0 * sigmas(told)).all()


def test_until_somebody_comes_nothing_is_different() -> None:
    recording, told = simulated(JOINING).recording, walked(JOINING, SHORT)
    without = recording.ranges.select((recording.ranges.a != 2) & (recording.ranges.b != 2))
    alone = feed(recording, messages(replace(recording, ranges=without)), SHORT)
    assert alone.states[-1][2] is State.DISCONNECTED
    assert alone.frames[-1][2] is None
    came = sum(t < 0.5 * JOINING.seconds for t in told.t)
    assert told.frames[:came] == alone.frames[:came]


@cache
def left(poses_too: bool) -> Told:
    """The last user ranges no more after 8 s, and its SLAM may go on."""
    scene = replace(CLEAN, users=3)
    recording = simulated(scene).recording
    r, track = recording.ranges, recording.tracks["phone2"]
    recording = replace(recording, ranges=r.select((r.t < 8.0) | ((r.a != 2) & (r.b != 2))))
    if poses_too:
        until = track.t < 8.0
        short = replace(track, t=track.t[until], position=track.position[until], quat_xyzw=track.quat_xyzw[until])
        recording = replace(recording, tracks={**recording.tracks, "phone2": short})
    return feed(recording, messages(recording), SHORT)


def test_who_leaves_is_disconnected_after_the_window_and_the_others_stay() -> None:
    told = left(poses_too=True)
    assert told.first(2, State.REGISTERED) < 8.0
    assert told.states[-1] == [State.REGISTERED, State.REGISTERED, State.DISCONNECTED]
    went = next(t for t, events in zip(told.t, told.events, strict=True) if "phone2: disconnected" in " ".join(events))
    assert 8.0 < went < 8.0 + SHORT.incremental.window + 2.0
    assert set(told.engine.following.tracking.members) == {0, 1}
    assert told.engine.roster.standings[2].since is None


@pytest.mark.parametrize("poses_too", [False, True])
def test_who_leaves_is_not_called_registered_without_a_frame(poses_too: bool) -> None:
    told = left(poses_too)
    for states, frames in zip(told.states, told.frames, strict=True):
        assert states[2] is not State.REGISTERED or frames[2] is not None


def test_where_the_reference_leaves_the_others_go_on() -> None:
    scene = replace(CLEAN, users=3)
    recording = simulated(scene).recording
    r, track = recording.ranges, recording.tracks["phone0"]
    until = track.t < 8.0
    short = replace(track, t=track.t[until], position=track.position[until], quat_xyzw=track.quat_xyzw[until])
    recording = replace(
        recording,
        ranges=r.select((r.t < 8.0) | ((r.a != 0) & (r.b != 0))),
        tracks={**recording.tracks, "phone0": short},
    )
    told = feed(recording, messages(recording), SHORT)
    assert set(told.engine.following.tracking.members) == {1, 2}
    assert told.engine.following.gauge in (1, 2)
    assert told.states[-1] == [State.REGISTERED] * 3


# ---- what devices say of themselves ----


@pytest.mark.parametrize("call", ["lost_tracking", "new_session"])
def test_whose_slam_began_anew_is_looked_for_anew_and_found(call: str) -> None:
    """From 7 s on its frame is another one."""
    recording = simulated(CLEAN).recording
    turn = YawFrame(5.0, -3.0, 0.5, 1.2)
    track = recording.tracks["phone1"]
    later = track.t >= 7.0
    position, quat = track.position.copy(), track.quat_xyzw.copy()
    position[later], quat[later] = turn @ position[later], turn.rotate_quaternions(quat[later])
    moved = replace(recording, tracks={**recording.tracks, "phone1": replace(track, position=position, quat_xyzw=quat)})
    told = feed(moved, [*messages(moved), (6.999, lambda e: getattr(e, call)(1))])
    at = told.t.index(next(t for t in told.t if t >= 7.0))
    assert told.states[at - 1][1] is State.REGISTERED
    assert told.states[at][1] is State.UNOBSERVABLE
    assert any(event.startswith("phone1: unobservable: its SLAM") for event in told.events[at])
    assert told.frames[at][1] is None
    assert told.states[-1][1] is State.REGISTERED
    frame, last = told.frames[-1][1], track.position[-1]
    true = common_from_world(simulated(CLEAN), "phone0") @ simulated(CLEAN).world_from_user["phone1"]
    assert frame is not None
    assert np.linalg.norm((frame @ (turn @ last) - true @ last)[:2]) < 0.6
    assert told.engine.jumps(1) == ()


def test_who_takes_a_lift_is_registered_again_where_it_gets_out() -> None:
    """Its SLAM sees the cabin: the prior of its height holds no more."""
    simulation = simulate(Scene(users=4, seconds=32.0, seed=1))
    begin = float(simulation.recording.ranges.t.min())
    up = sliding(simulation.truth["phone1"].t, np.array([0.0, 0.0, 1.0]), begin + 8.0, begin + 13.0)
    lifted = with_truth_moved(simulation, {"phone1": up})
    told = feed(lifted.recording, messages(lifted.recording))
    assert State.UNOBSERVABLE in [
        s[1] for s, t in zip(told.states, told.t, strict=True) if begin + 8.0 < t < begin + 13.0
    ]
    assert told.states[-1][1] is State.REGISTERED
    assert told.engine.roster.standings[1].lifted
    frame = told.frames[-1][1]
    assert frame is not None
    true = common_from_world(lifted, "phone0") @ lifted.truth["phone1"].position[-1]
    assert np.linalg.norm(frame @ lifted.recording.tracks["phone1"].position[-1] - true) < 0.6
    told.engine.new_session(1)
    assert not told.engine.roster.standings[1].lifted


def test_a_static_radio_has_no_slam_to_lose() -> None:
    engine = Engine((User("a"), User("post", static=True)), 0)
    engine.lost_tracking(1)
    assert engine.advance(0.0) == []


@pytest.mark.parametrize("name", ["phone2", "abe"])
def test_a_user_who_is_added_while_people_walk_is_registered(name: str) -> None:
    recording = simulated(replace(CLEAN, users=3)).recording
    r, track = recording.ranges, recording.tracks["phone2"]
    later = track.t >= 5.0
    late = replace(track, t=track.t[later], position=track.position[later], quat_xyzw=track.quat_xyzw[later])
    coming = replace(
        recording,
        ranges=r.select((r.t >= 5.0) | ((r.a != 2) & (r.b != 2))),
        tracks={**recording.tracks, "phone2": late},
    )
    whole = messages(coming)
    user = replace(coming.users[2], name=name)
    pair = feed(coming, [*whole, (5.0 - 1e-9, lambda e: e.add_user(user))], known=2)
    assert pair.engine.users == (*recording.users[:2], user)
    assert [len(states) for states in pair.states[:1] + pair.states[-1:]] == [2, 3]
    assert pair.states[-1] == [State.REGISTERED] * 3
    assert pair.frames[-1][2] is not None


# ---- a window that is shorter than the walk ----


def test_what_is_kept_does_not_grow_with_the_walk() -> None:
    scene = replace(CLEAN, seconds=30.0, seed=5)
    told = walked(scene, SHORT)
    kept = np.array([kept for kept, t in zip(told.kept, told.t, strict=True) if t > 18.0])
    assert len(kept) > 50
    poses, ranges, slots = kept.max(axis=0)
    window = SHORT.incremental.window
    assert poses < 2.0 * (window + 4.0) * scene.track_rate_hz  # tables are cut when a quarter is free
    assert ranges < (window + 3.0) * scene.round_hz * 1.5
    assert slots <= window + 2
    tracking = told.engine.following.tracking
    assert len(tracking.slots) <= 2 * (window + 2)
    assert len(tracking._steps) <= 2 * (window + 2)


def test_a_short_window_ends_about_where_the_whole_does() -> None:
    short, whole, simulation = walked(CLEAN, SHORT), walked(CLEAN), simulated(CLEAN)
    apart = np.abs(errors(short, simulation) - errors(whole, simulation))
    assert (apart < 2.0 * sigmas(short)).all()
    assert (np.abs(errors(short, simulation)) < 4.0 * sigmas(short)).all()
    # What was marginalised is believed: four seconds by themselves would not tell as much.
    assert (sigmas(short) < 2.0 * sigmas(whole)).all()


# ---- states and events ----

RUNS: dict[str, Callable[[], Told]] = {
    "noisy": lambda: walked(NOISY),
    "windowed": lambda: walked(CLEAN, SHORT),
    "joining": lambda: walked(JOINING, SHORT),
    "leaving": lambda: left(poses_too=True),
}


@pytest.mark.parametrize("run", RUNS)
def test_every_change_of_state_is_an_event(run: str) -> None:
    told = RUNS[run]()
    users = told.engine.users
    before = [State.REGISTERED] + [State.DISCONNECTED] * (len(users) - 1)
    for states, events in zip(told.states, told.events, strict=True):
        last = {event.split(": ")[0]: event.split(": ")[1] for event in events}
        for user, old, new in zip(users, before, states, strict=True):
            assert old is new or last[user.name] == new
        before = states


@pytest.mark.parametrize("run", RUNS)
def test_whoever_is_registered_has_a_frame_once_anything_is_solved(run: str) -> None:
    told = RUNS[run]()
    for states, frames in zip(told.states, told.frames, strict=True):
        for state, frame in zip(states[1:], frames[1:], strict=True):
            assert state is not State.REGISTERED or frame is not None
            assert state is not State.DISCONNECTED or frame is None
