"""A room without network, processes or wall time: the test sets the clock, and says what the solver knows."""

from __future__ import annotations

import json

import msgspec
import numpy as np
import pytest
from support.house import House, datagram, only, refused, user_frame

from synchronizar.geometry import YawFrame
from synchronizar.io.datagrams import decode_order
from synchronizar.live import messages as m
from synchronizar.live.joining import TOKEN_S
from synchronizar.live.lobby import TRIES_A_MINUTE, Lobby
from synchronizar.live.messages import MessageError
from synchronizar.live.pose_wire import PosesDown, PoseUp, encode_poses_up
from synchronizar.live.solver_wire import Lost, NewFrame, Pose, Range, Told


def test_who_comes_is_told_everything_and_the_others_are_told_of_it() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.said_to(alice)
    bob, _ = house.enter("bob")
    welcome = house.said_to(bob)[0]
    assert isinstance(welcome, m.Welcome)
    assert (welcome.you, [member.name for member in welcome.members]) == (["bob"], ["alice", "bob"])
    members = only(m.Members, house.said_to(alice)).members
    assert [(member.name, member.here) for member in members] == [("alice", True), ("bob", True)]


def test_poses_and_ranges_reach_the_solver_by_the_rooms_clock() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.enter("bob")
    # Her clock counts from her own start: it is 1000 s behind the room's.
    house.pose(alice, 1.0, t=0.0)
    house.clock.t += 0.5
    house.room.hear(alice, m.Ranges([m.MeasuredRange(0.25, "alice", "bob", 4.0, nlos=True)]))
    assert [(p.user, p.t, p.position) for p in house.solver.of(Pose)] == [("alice", 1000.0, (1.0, 0.0, 0.0))]
    assert [(r.t, r.a, r.b, r.distance, r.optional) for r in house.solver.of(Range)] == [
        (pytest.approx(1000.25), "alice", "bob", 4.0, {"nlos": 1.0})
    ]


def test_poses_of_a_device_that_pings_wait_until_its_clock_is_known() -> None:
    house = House()
    alice, _ = house.enter("alice")
    # Her clock is 1000 s behind the room's, and each way takes 0.2 s.
    house.room.hear(alice, m.Ping(-0.2))
    house.pose(alice, 1.0, t=-0.2)
    house.clock.t += 0.5
    house.pose(alice, 2.0, t=0.3)
    house.room.hear(alice, m.Ping(0.3, 1000.0, 0.4))
    house.room.tick()
    assert house.solver.of(Pose) == []
    house.clock.t += 0.7
    house.room.tick()
    assert [pose.t for pose in house.solver.of(Pose)] == [pytest.approx(999.8), pytest.approx(1000.3)]
    house.pose(alice, 3.0, t=1.0)
    assert house.solver.of(Pose)[-1].t == pytest.approx(1001.0)


def test_a_member_cannot_speak_for_another() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.enter("bob")
    house.enter("carol")
    house.said_to(alice)
    house.room.hear(alice, m.Ranges([m.MeasuredRange(house.clock.t, "bob", "carol", 4.0)]))
    house.room.hear(alice, m.Reset("bob", 1))
    house.room.hear(alice, m.Lost("bob"))
    house.room.hear(alice, m.Module("bob", 3))
    house.room.hear(alice, m.Create("x", "coin", (0.0, 0.0, 0.0), user="bob"))
    house.pose(alice, 1.0, user=1)
    assert house.solver.of(Range) == house.solver.of(NewFrame) == house.solver.of(Lost) == house.solver.of(Pose) == []
    assert "user" in refused(house.said_to(alice))
    assert house.room.status().users["alice"].refused == {"user": 6}


def test_stamps_from_the_future_and_from_long_ago_are_refused_and_counted() -> None:
    house = House()
    alice, _ = house.enter("alice")
    for n in range(30):  # her clock is known
        house.clock.t += 0.1
        house.pose(alice, 0.1 * n)
    house.pose(alice, 1.0, t=house.clock.t - 60.0)
    assert refused(house.said_to(alice)).keys() == {"old"}
    assert len(house.solver.of(Pose)) == 30


def test_a_new_frame_is_never_the_old_one() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.pose(alice, 5.0)
    house.told(alice=YawFrame())
    house.room.hear(alice, m.Reset("alice", 1))
    assert [(c.user, c.frame) for c in house.solver.of(NewFrame)] == [("alice", 1)]
    house.pose(alice, 5.0, frame=0)  # still under way
    assert "frame" in refused(house.said_to(alice))
    house.pose(alice, 0.0, frame=1)
    house.room.tick()
    # What is known is about the old frame: nothing is shown by it.
    assert only(PosesDown, house.said_to(alice)).poses == []


def test_everybodys_poses_are_in_the_common_frame() -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob", up="y")
    bob_in_common = YawFrame(1.0, 2.0, 0.5, 0.7, 1.02, "y")
    position, quat = np.array([0.4, 1.5, -2.0]), np.array([0.1, 0.7, 0.1, 0.7])
    quat /= np.linalg.norm(quat)
    up = encode_poses_up([PoseUp(0, 0, 1, house.clock.t, tuple(position.tolist()), tuple(quat.tolist()))])
    house.room.hear_poses(bob, up)
    house.told(alice=YawFrame(), bob=bob_in_common)
    house.room.tick()
    shown = only(PosesDown, house.said_to(alice)).poses
    assert [pose.member for pose in shown] == [1]
    np.testing.assert_allclose(shown[0].position, bob_in_common @ position, atol=1e-9)
    np.testing.assert_allclose(shown[0].quat_xyzw, bob_in_common.rotate_quaternions(quat[None])[0], atol=1e-6)


def test_frames_are_told_when_they_change_and_twice_a_second() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.said_to(alice)
    versions = []
    for n in range(20):
        house.clock.t += 0.1
        house.told(alice=YawFrame(), bob=YawFrame(x=float(n >= 10)))
        versions += [word.version for word in house.said_to(alice) if isinstance(word, m.Frames)]
    assert versions[0] == 1
    assert versions.count(2) >= 2
    assert len(versions) <= 6


def test_who_reloads_is_the_same_device_and_who_only_says_its_name_is_not() -> None:
    house = House()
    alice, secret = house.enter("alice")
    with pytest.raises(MessageError, match="somebody called 'alice' already"):
        house.enter("alice")
    again, _ = house.enter("alice", resume=secret)
    assert house.room.devices["alice"].client is again
    assert house.said_to(alice)[-1] == m.Bye("elsewhere", "the same device has joined from somewhere else")
    house.room.disconnect(alice)
    assert house.room.devices["alice"].client is again


def test_who_only_looks_hears_everything_and_changes_nothing() -> None:
    house = House()
    house.enter("alice")
    looking, _ = house.enter()
    house.room.hear(looking, m.Create("x", "coin", (0.0, 0.0, 0.0)))
    house.room.hear(looking, m.Ranges([m.MeasuredRange(1.0, "alice", "bob", 1.0)]))
    house.room.tick()
    words = house.said_to(looking)
    assert {"spectator", "user"} <= refused(words).keys()
    assert only(m.Status, words).users.keys() == {"alice"}
    assert house.room.objects.objects == {}


def test_a_modules_key_is_its_own() -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.room.hear(alice, m.Module("alice", 7))
    house.room.hear(bob, m.Module("bob", 7))
    house.room.hear(bob, m.Module("bob", 8))
    own, other = only(m.ModuleKey, house.said_to(alice)), only(m.ModuleKey, words := house.said_to(bob))
    assert "address" in refused(words)
    assert own.key != other.key
    assert len(bytes.fromhex(own.key)) == 32
    assert own.session == other.session


def test_modules_ranges_come_in_by_the_rooms_clock_and_with_their_own_keys_alone() -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.room.hear(alice, m.Module("alice", 7))
    house.room.hear(bob, m.Module("bob", 8))
    own, other = house.room.modules.keys.of(7), house.room.modules.keys.of(8)
    for n in range(40):
        house.clock.t += 0.05
        house.room.hear_datagram(datagram(house, 7, 8, n, 5.0 + 0.05 * n, 4000 + n, own), house.clock.t + 0.003)
    forged = datagram(house, 7, 8, 100, 7.1, 9000, other)
    assert house.room.hear_datagram(forged, house.clock.t) is None
    assert house.room.hear_datagram(datagram(house, 7, 8, 3, 5.15, 9000, own), house.clock.t) is None  # played again
    assert house.room.hear_datagram(datagram(house, 7, 9, 101, 7.1, 9000, own), house.clock.t + 0.1) is not None
    ranges = house.solver.of(Range)
    assert [round(1000.0 * r.distance) for r in ranges] == list(range(4000, 4040))
    np.testing.assert_allclose([r.t for r in ranges], 1000.05 + 0.05 * np.arange(40), atol=0.004)
    assert ranges[0].optional == {"source": "module", "sigma": 0.05, "rx_power": -80.0, "fp_power": -81.0, "nlos": 0.0}
    refused_ = house.room.status().refused
    assert refused_ == {"datagram tag": 1, "datagram sequence": 1, "datagram peer": 1}


class Modules:
    """Alice's and Bob's modules in a room; Alice's takes no orders."""

    def __init__(self) -> None:
        self.house, self.sent = House(), 0
        for name, address in (("alice", 7), ("bob", 8)):
            self.house.room.hear(self.house.enter(name)[0], m.Module(name, address))
        self.own = self.house.room.modules.keys.of(7)

    def orders(self, seconds: float) -> set[int]:
        """s of sleep that alice's module is told meanwhile."""
        told = set()
        for n in range(self.sent, self.sent + round(10 * seconds)):
            self.house.clock.t += 0.1
            word = datagram(self.house, 7, 8, n, 5.0 + 0.1 * n, 4000, self.own)
            heard = self.house.room.hear_datagram(word, self.house.clock.t)
            assert heard is not None
            for order in self.house.room.orders_for(heard, self.house.clock.t):
                read = decode_order(order, self.own)
                assert (read.module, read.sequence) == (7, n)
                told.add(read.sleep_s)
            self.house.room.tick()
        self.sent += round(10 * seconds)
        return told

    def told(self, bob: str, x: float = 0.0) -> None:
        """Bob has that state, and a frame that is known to 2 cm and lies at `x` m."""
        covariance = (0.02**2 * np.eye(4)).tolist()
        users = {"alice": user_frame(YawFrame()), "bob": user_frame(YawFrame(x=x), bob)}
        users["bob"] = msgspec.structs.replace(users["bob"], covariance=covariance)
        self.house.room.told(Told(self.house.clock.t, 1, "alice", users, [], [], 0.01))

    def alice_sleeps(self) -> bool:
        return self.house.room.status().users["alice"].asleep


def test_modules_are_told_to_sleep_when_all_are_registered_and_to_range_on_when_one_is_not() -> None:
    modules = Modules()
    modules.told("unobservable")
    assert modules.orders(30.0) == {0}
    modules.told("registered")
    assert modules.orders(19.0) == {0}
    assert max(modules.orders(20.0)) > 1
    assert modules.alice_sleeps()
    modules.told("ambiguous")
    modules.orders(1.0)
    assert modules.orders(20.0) == {0}
    assert not modules.alice_sleeps()


def test_modules_range_on_when_somebody_was_corrected_by_more_than_what_was_told() -> None:
    modules = Modules()
    modules.told("registered")
    modules.orders(30.0)
    assert modules.alice_sleeps()
    modules.told("registered", 0.03)
    assert min(modules.orders(5.0)) > 0, "as sure as it was told to be"
    modules.told("registered", 0.5)
    modules.orders(1.0)
    assert modules.orders(18.0) == {0}
    assert not modules.alice_sleeps()
    assert max(modules.orders(5.0)) > 1, "it has agreed with itself for a while"


def test_recorded_time_is_what_its_client_says_and_the_answer_comes_to_it() -> None:
    house = House()
    player, _ = house.enter("alice", "bob", time="recorded")
    with pytest.raises(MessageError, match="plays a recording"):
        house.enter("carol")
    looking, _ = house.enter()
    house.room.hear(looking, m.Clock(5.0))
    assert "time" in refused(house.said_to(looking))
    house.pose(player, 1.0, t=12.0, user=1)
    house.room.hear(player, m.Clock(12.1))
    house.clock.t += 100.0
    house.room.tick()
    house.room.hear(player, m.Clock(11.0))
    house.room.hear(player, m.Finish(12.2))
    assert (house.solver.asked, house.solver.finished_at) == ([12.1], [12.2])
    assert [(p.user, p.t) for p in house.solver.of(Pose)] == [("bob", 12.0)]
    house.room.finished({"users": {}})
    words = house.said_to(player)
    assert refused(words) == {"time": "a recording's time goes forwards"}
    assert only(m.Answer, words).registration == {"users": {}}


def test_the_solver_is_asked_ten_times_a_second_whoever_speaks() -> None:
    house = House()
    house.enter("alice")
    for _ in range(300):
        house.clock.t += 1.0 / 30.0
        house.room.tick()
    assert 95 <= len(house.solver.asked) <= 101


def test_what_waits_for_registration_is_put_down_where_its_device_was() -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.room.hear(bob, m.Create("coin", "coin", (2.0, 0.0, 0.0), user="bob"))
    house.room.tick()
    assert [w for w in house.said_to(alice) if isinstance(w, m.Objects)] == []
    house.told(alice=YawFrame(), bob=YawFrame(x=1.0, yaw=np.pi / 2))
    house.room.tick()
    (coin,) = only(m.Objects, house.said_to(alice)).changed
    np.testing.assert_allclose(coin.position, [1.0, 2.0, 0.0], atol=1e-9)


def test_what_somebody_says_is_handed_on_with_its_name() -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    carol, _ = house.enter("carol")
    for client in (alice, bob, carol):
        house.said_to(client)
    house.room.hear(alice, m.Say("wave", {"hand": "left"}))
    house.room.hear(alice, m.Say("wave", 2, to="bob"))
    house.room.hear(alice, m.Signal("bob", {"sdp": "..."}))
    house.room.hear(alice, m.Say("wave", 3, to="dave"))
    said = [(w.data, w.by) for w in house.said_to(bob) if isinstance(w, m.Said | m.Signalled)]
    assert said == [({"hand": "left"}, "alice"), (2, "alice"), ({"sdp": "..."}, "alice")]
    assert len(house.said_to(carol)) == 1
    assert refused(house.said_to(alice)) == {"user": "'dave' is not here"}


def test_a_word_that_is_refused_again_and_again_is_not_told_each_time() -> None:
    house = House()
    alice, _ = house.enter("alice")
    house.said_to(alice)
    for _ in range(500):
        house.room.hear(alice, m.Grab("nothing"))
    counts = [word.count for word in house.said_to(alice) if isinstance(word, m.Refused)]
    assert counts == [1, 10, 100]


def test_a_token_is_used_once_and_soon() -> None:
    house = House()
    lobby = Lobby(house.clock)
    lobby.add(house.room)
    first = lobby.join(m.Join("co-de ", [m.UserSettings("alice")]), "10.0.0.2")
    assert lobby.redeem(first.token)[1].users == ["alice"]
    with pytest.raises(MessageError, match="join again"):
        lobby.redeem(first.token)
    late = lobby.join(m.Join("CODE", [m.UserSettings("bob")]), "10.0.0.2")
    house.clock.t += TOKEN_S + 1.0
    with pytest.raises(MessageError, match="join again"):
        lobby.redeem(late.token)


def test_codes_cannot_be_tried_one_after_the_other() -> None:
    house = House()
    lobby = Lobby(house.clock)
    lobby.add(house.room)
    for n in range(TRIES_A_MINUTE):
        with pytest.raises(MessageError, match="no room"):
            lobby.join(m.Join(f"WRONG{n}"), "10.0.0.66")
    with pytest.raises(MessageError, match="wait a minute"):
        lobby.join(m.Join("CODE"), "10.0.0.66")
    lobby.join(m.Join("CODE"), "10.0.0.2")  # others are not disturbed
    house.clock.t += 61.0
    lobby.join(m.Join("CODE"), "10.0.0.66")


def test_nothing_that_a_client_is_told_holds_a_secret() -> None:
    house = House()
    alice, secret = house.enter("alice")
    house.enter("bob")
    house.room.hear(alice, m.Module("alice", 7))
    house.room.tick()
    words = [word for word in house.said_to(alice) if not isinstance(word, PosesDown | m.ModuleKey)]
    text = json.dumps([m.encode(word).decode() for word in words])
    assert secret not in text
    assert house.room.key.hex() not in text


def test_places_that_change_are_told_five_times_a_second_at_most_and_states_at_once() -> None:
    house = House()
    alice, _ = house.enter("alice", "bob")
    house.told(alice=YawFrame(), bob=YawFrame(x=1.0))
    house.said_to(alice)
    told = []
    for n in range(1, 11):
        house.clock.t += 0.1
        house.told(alice=YawFrame(), bob=YawFrame(x=1.0 + 0.01 * n))
        told += [(n, word) for word in house.said_to(alice) if isinstance(word, m.Frames)]
    assert [n for n, _ in told] == [2, 4, 6, 8, 10]
    assert told[-1][1].users["bob"].x == pytest.approx(1.1)
    house.clock.t += 0.01
    house.told(alice=YawFrame())
    assert set(only(m.Frames, house.said_to(alice)).users) == {"alice"}
    house.clock.t += 0.01
    house.told(alice=YawFrame(x=0.5))
    assert not [word for word in house.said_to(alice) if isinstance(word, m.Frames)]
    house.clock.t += 0.2
    house.told(alice=YawFrame(x=0.5))  # nothing has changed since, and it has not been told yet
    assert only(m.Frames, house.said_to(alice)).users["alice"].x == 0.5
