"""Who may do what: in a room, at its door, and at its port. Nothing here needs a network, processes or wall time."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import get_args

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.house import NO_TURN, House, datagram, only, refused

from synchronizar.live import messages as m
from synchronizar.live.budget import HANDED_ON_A_SECOND, MEASURED_A_SECOND, MOST_ADDRESSES, WORDS_A_SECOND, Tally
from synchronizar.live.connection import hear_word
from synchronizar.live.joining import MOST_DEVICES, MOST_SPECTATORS, TOKEN_S
from synchronizar.live.lobby import JOINS_A_MINUTE, MOST_WAITING_FROM_ONE, TRIES_A_MINUTE, Lobby
from synchronizar.live.measuring import RESETS_AT_ONCE
from synchronizar.live.member import Client
from synchronizar.live.messages import MessageError
from synchronizar.live.modules import MOST_ADDRESSES_OF_ONE
from synchronizar.live.objects import MOST_DATA
from synchronizar.live.origin import is_own
from synchronizar.live.outbox import MOST_BYTES, Outbox
from synchronizar.live.pose_wire import PoseUp, encode_poses_up
from synchronizar.live.recorder import FolderRecorder
from synchronizar.live.room import Room
from synchronizar.live.solver_wire import AddUser, Lost, NewFrame, Pose, Range
from synchronizar.live.web import Silence


@pytest.fixture
def house() -> House:
    return House()


@pytest.fixture
def lobby(house: House) -> Lobby:
    out = Lobby(house.clock)
    out.add(house.room)
    return out


def join(*names: str, resume: str | None = None) -> m.Join:
    return m.Join("CODE", [m.UserSettings(name) for name in names], resume=resume)


# Names and secrets


def test_names_of_those_who_never_come_are_free_again_when_their_tokens_are_too_old(house: House) -> None:
    for n in range(MOST_DEVICES):
        house.room.admit(join(f"nobody{n}"))
    with pytest.raises(MessageError, match="open another room"):
        house.room.admit(join("alice"))
    assert house.room.devices == {}
    assert house.solver.of(AddUser) == []
    house.clock.t += TOKEN_S + 1.0
    house.enter("alice")
    assert [added.user.name for added in house.solver.of(AddUser)] == ["alice"]


def test_a_name_is_kept_for_whoever_has_a_token_and_for_nobody_else(house: House) -> None:
    ticket, secret = house.room.admit(join("alice"))
    with pytest.raises(MessageError, match="already"):
        house.room.admit(join("alice"))
    again, _ = house.room.admit(join("alice", resume=secret))  # its first answer was lost on the way
    first = house.room.connect(ticket)
    assert house.room.connect(again).devices == first.devices


def test_a_secret_that_a_client_has_made_up_opens_nothing(house: House) -> None:
    _, secret = house.enter("alice", resume="1234")
    assert secret != "1234"
    assert len(secret) >= 32
    with pytest.raises(MessageError, match="already"):
        house.room.admit(join("alice", resume="1234"))


@pytest.mark.parametrize("name", ["Bob", "BOB", "\uff42ob"])
def test_a_name_that_may_be_taken_for_anothers_is_refused(house: House, name: str) -> None:
    house.enter("bob")
    with pytest.raises(MessageError, match="another one"):
        house.room.admit(join(name))


@pytest.mark.parametrize(
    "name",
    ["", " bob", "bob ", ".", "..", "../bob", "a/b", "a\\b", "a\nb", "a\x00b", "\ud800", "x" * 65, "\U0001f600" * 64],
)
def test_what_is_no_files_name_is_no_name(house: House, name: str) -> None:
    with pytest.raises(MessageError, match="cannot be a name"):
        house.room.admit(join(name))


def test_a_new_frame_is_never_recorded_under_anothers_name(tmp_path: Path) -> None:
    house = House(recorder=FolderRecorder(tmp_path))
    mallory, _ = house.enter("bob~2")
    bob, _ = house.enter("bob")
    house.pose(mallory, 9.0)
    house.room.hear(bob, m.Reset("bob", 1))
    house.pose(bob, 1.0, frame=1)
    house.recorder.close()
    assert sorted(path.name for path in (tmp_path / "tracks").iterdir()) == ["bob~2.tum", "bob~3.tum"]
    assert " 9.000" in (tmp_path / "tracks" / "bob~2.tum").read_text()
    with pytest.raises(MessageError, match="another one"):
        house.room.admit(join("Bob~3"))


@pytest.mark.parametrize(
    "settings",
    [
        {"height_sigma": 0.0},
        {"height_sigma": -1.0},
        {"height_sigma": 1e-9},
        {"height_sigma": 1e300},
        {"static": True, "antennas": {"tip": (0.0, 0.0, 0.0)}},
        {"antennas": {"tip": (0.0, 0.0, 1e300)}},
        {"antennas": {"a\nb": (0.0, 0.0, 0.0)}},
        {"antennas": {f"{n}": (0.0, 0.0, 0.0) for n in range(17)}},
    ],
)
def test_settings_that_no_recording_may_have_are_refused(house: House, settings: dict[str, object]) -> None:
    with pytest.raises(MessageError):
        house.room.admit(m.Join("CODE", [m.UserSettings("alice", **settings)]))  # type: ignore[arg-type]


# Who speaks for whom


def test_who_only_looks_says_neither_what_time_it_is_nor_anything_to_others(house: House) -> None:
    alice, _ = house.enter("alice")
    looking, _ = house.enter(time="recorded")
    house.said_to(alice)
    for word in (m.Clock(9e9), m.Finish(9e9), m.Say("x", 1), m.Signal("alice", {}), m.Ranges([a_range(house)])):
        house.room.hear(looking, word)
    house.pose(looking, 1.0)
    assert (house.solver.asked, house.solver.finished_at, house.said_to(alice)) == ([], [], [])
    assert house.solver.of(Pose) + house.solver.of(Range) == []
    assert refused(house.said_to(looking)).keys() == {"time", "spectator", "user"}


def test_an_address_whose_key_somebody_has_is_never_given_to_another(house: House) -> None:
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.room.hear(alice, m.Module("alice", 7))
    house.room.hear(alice, m.Module("alice", 8))  # she has the key of 7 still
    house.room.hear(bob, m.Module("bob", 7))
    assert "address" in refused(house.said_to(bob))
    assert house.room.modules.users == {8: "alice"}
    house.room.hear(alice, m.Module("alice", 7))
    assert house.room.modules.users == {7: "alice"}
    again = Room("CODE", house.clock, house.room.key)
    again.restore(house.room.roster())
    assert again.modules.given == {7: "alice", 8: "alice"}


def test_nobody_takes_all_addresses(house: House) -> None:
    alice, _ = house.enter("alice")
    for address in range(100):
        house.room.hear(alice, m.Module("alice", address))
    assert len(house.room.modules.given) == MOST_ADDRESSES_OF_ONE
    assert "address" in refused(house.said_to(alice))


def test_texts_of_a_range_are_those_that_its_devices_declared(tmp_path: Path) -> None:
    house = House(recorder=FolderRecorder(tmp_path))
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.enter("carol")
    for client in (alice, bob):
        house.pose(client, 1.0)
    t = house.clock.t
    evil = f"\n{t},bob,carol,1.0"
    for spoilt in ({"antenna_a": evil}, {"antenna_b": evil}, {"source": evil}, {"antenna_a": "left"}):
        house.room.hear(alice, m.Ranges([m.MeasuredRange(t, "alice", "bob", 2.0, **spoilt)]))  # type: ignore[arg-type]
    house.room.hear(alice, m.Ranges([m.MeasuredRange(t, "alice", "bob", 2.0, source="module")]))
    house.recorder.close()
    rows = list(csv.reader((tmp_path / "ranges.csv").read_text().splitlines()))
    assert [row[1:4] for row in rows[1:]] == [["alice", "bob", "2.0"]]
    assert house.room.status().users["alice"].refused == {"antenna": 3, "source": 1}


def test_frame_numbers_that_are_the_same_modulo_256_are_the_same(house: House) -> None:
    alice, _ = house.enter("alice")
    house.room.hear(alice, m.Reset("alice", 256))
    assert "frame" in refused(house.said_to(alice))
    assert house.solver.of(NewFrame) == []


def test_who_stands_still_has_no_slam_to_lose(house: House) -> None:
    ticket, _ = house.room.admit(m.Join("CODE", [m.UserSettings("radio", static=True)]))
    radio = house.room.connect(ticket)
    house.room.hear(radio, m.Lost("radio"))
    house.room.hear(radio, m.Reset("radio", 1))
    assert house.solver.of(Lost) + house.solver.of(NewFrame) == []
    assert house.room.status().users["radio"].refused == {"static": 2}


# What makes no sense


def a_range(house: House, **other: object) -> m.MeasuredRange:
    return m.MeasuredRange(**({"t": house.clock.t, "a": "alice", "b": "bob", "distance": 3.0} | other))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("other", "reason"),
    [
        ({"distance": -5.0}, "distance"),
        ({"distance": 1e6}, "distance"),
        ({"distance": 1e308}, "distance"),
        ({"sigma": 0.0}, "value"),
        ({"sigma": -0.1}, "value"),
        ({"rx_power": 1e308}, "value"),
        ({"t": 1e308}, "value"),
        ({"t": -1e308}, "value"),
        ({"t": 1060.0}, "future"),
        ({"t": 900.0}, "old"),
        ({"a": "carol"}, "user"),
        ({"b": "x" * 1000}, "user"),
        ({"b": "alice"}, "value"),
    ],
)
def test_a_range_that_no_radio_measures_is_refused_and_counted_and_others_are_taken(
    house: House, other: dict[str, object], reason: str
) -> None:
    alice, _ = house.enter("alice")
    house.enter("bob")
    for _ in range(30):  # her clock is known
        house.room.hear(alice, m.Ping(house.clock.t))
        house.clock.t += 0.1
    good = a_range(house)
    house.room.hear(alice, m.Ranges([good, a_range(house, **other), good]))
    assert len(house.solver.of(Range)) == 2
    assert house.room.status().users["alice"].refused == {reason: 1}


@pytest.mark.parametrize(
    "word",
    [
        '{"type":"ping","t":NaN}',
        '{"type":"ping","t":Infinity}',
        '{"type":"ping","t":1e999}',
        '{"type":"ping","t":' + "9" * 400 + "}",
        '{"type":"say","topic":"x","data":' + "[" * 20000 + "]" * 20000 + "}",
        '{"type":"say","topic":"\\ud800"}',
        '{"type":"say","topic":"' + "x" * 70000 + '"}',
        '{"type":"module","user":"alice","address":-1}',
        '{"type":"module","user":"alice","address":99999999999999999999}',
        '{"type":"ping","t":1e300}',
        '{"type":"ping","t":1.0,"offset":-1e300}',
        '{"type":"ping","t":1.0,"round_trip":-1.0}',
        '{"type":"create","id":"../x\\n","kind":"x","position":[0,0,0]}',
        '{"type":"create","id":"x","kind":"x","position":[1e300,0,0]}',
        '{"type":"create","id":"x","kind":"x","position":[0,0,0],"quat_xyzw":[0,0,0,0]}',
        '{"type":"welcome"}',
        "[]",
        "",
    ],
)
def test_words_that_make_no_sense_are_refused_counted_and_told(house: House, word: str) -> None:
    alice, _ = house.enter("alice")
    house.enter("bob")
    house.said_to(alice)
    hear_word(house.room, alice, word)
    assert sum(house.room.status().users["alice"].refused.values()) == 1
    assert len(refused(house.said_to(alice))) == 1
    assert house.room.objects.objects == {}


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        ({"mm": -5_000}, "distance"),
        ({"mm": -(2**31)}, "distance"),
        ({"t": 5000.0 + 3600.0}, "future"),
        ({"t": 5000.0 - 3600.0}, "old"),
        ({"t": 5002.45}, None),
        ({"sequence": 5}, "sequence"),
        ({"peer": 9}, "peer"),
        ({"key": bytes(32)}, "tag"),
    ],
)
def test_a_datagram_that_is_forged_replayed_or_of_another_time_is_refused_and_shown(
    house: House, spoil: dict[str, object], reason: str | None
) -> None:
    for name, address in (("alice", 7), ("bob", 8)):
        house.room.hear(house.enter(name)[0], m.Module(name, address))
    key = house.room.modules.keys.of(7)
    for n in range(50):
        house.clock.t += 0.05
        told = datagram(house, 7, 8, n, 5000.0 + 0.05 * n, 4000, key)
        assert house.room.hear_datagram(told, house.clock.t) is not None
    before = len(house.solver.of(Range))
    asked = {"address": 7, "peer": 8, "sequence": 50, "t": 5002.5, "mm": 4000, "key": key} | spoil
    if asked["mm"] == -(2**31):
        asked["mm"] = 4000
        spoilt = bytearray(datagram(house, **asked))  # type: ignore[arg-type]
        spoilt[44:48] = bytes([0, 0, 0, 0x80])
        house.room.hear_datagram(bytes(spoilt), house.clock.t)
        reason = "tag"
    else:
        house.room.hear_datagram(datagram(house, **asked), house.clock.t)  # type: ignore[arg-type]
    taken = reason is None
    assert len(house.solver.of(Range)) == before + taken
    assert house.room.status().refused == ({} if reason is None else {f"datagram {reason}": 1})


def test_what_modules_sent_before_a_restart_is_not_taken_again(house: House) -> None:
    for name, address in (("alice", 7), ("bob", 8)):
        house.room.hear(house.enter(name)[0], m.Module(name, address))
    key = house.room.modules.keys.of(7)
    heard = [datagram(house, 7, 8, n, 5.0 + 0.05 * n, 4000, key) for n in range(5)]
    for data in heard:
        assert house.room.hear_datagram(data, house.clock.t) is not None
    again = Room("CODE", house.clock, house.room.key)
    again.restore(house.room.roster())
    assert [again.hear_datagram(data, house.clock.t) for data in heard] == [None] * 5
    assert again.status().refused == {"datagram sequence": 5}
    assert again.hear_datagram(datagram(house, 7, 8, 5, 5.3, 4000, key), house.clock.t) is not None


def test_a_room_at_a_recordings_time_hears_no_modules(house: House) -> None:
    player, _ = house.enter("alice", "bob", time="recorded")
    house.room.hear(player, m.Module("alice", 7))
    house.room.hear(player, m.Module("bob", 8))
    assert house.room.hear_datagram(datagram(house, 7, 8, 1, 5.0, 4000, house.room.modules.keys.of(7)), 1000.0) is None
    assert house.room.status().refused == {"datagram time": 1}


_ANYTHING = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)
_FIELDS = sorted({field for kind in get_args(m.FromClient) for field in kind.__struct_fields__})
_SAID = st.dictionaries(st.sampled_from(_FIELDS), _ANYTHING, max_size=6)
_TYPES = sorted(kind.__struct_config__.tag for kind in get_args(m.FromClient))


_WORD = st.binary(max_size=400) | st.text(max_size=200) | st.tuples(st.sampled_from(_TYPES), _SAID)


@settings(max_examples=50, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(_WORD, max_size=10))
def test_whatever_a_client_says_the_room_goes_on(said: list[bytes | str | tuple[str, dict[str, object]]]) -> None:
    house = House()
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    for word in said:
        if isinstance(word, tuple):
            word = json.dumps(word[1] | {"type": word[0]})
        if not alice.outbox.closed:
            hear_word(house.room, alice, word)
        if isinstance(word, bytes):
            house.room.hear_datagram(word, house.clock.t)
    house.room.tick()
    house.said_to(bob)
    house.pose(bob, 1.0)
    assert [pose.user for pose in house.solver.of(Pose)][-1:] == ["bob"]


# Floods


def test_a_flood_of_words_is_refused_and_who_waits_is_heard_again(house: House) -> None:
    alice, _ = house.enter("alice")
    for _ in range(5 * WORDS_A_SECOND):
        hear_word(house.room, alice, m.encode(m.Heartbeat()).decode())
    assert house.room.devices["alice"].refused == {"rate": WORDS_A_SECOND}
    house.clock.t += 1.0
    hear_word(house.room, alice, m.encode(m.Heartbeat()).decode())
    assert house.room.devices["alice"].refused == {"rate": WORDS_A_SECOND}


def test_a_flood_of_bytes_is_refused(house: House) -> None:
    alice, _ = house.enter("alice")
    for _ in range(100):
        hear_word(house.room, alice, "x" * m.LARGEST_MESSAGE)
    assert house.room.devices["alice"].refused == {"malformed": 8, "rate": 92}


def test_a_flood_of_poses_ranges_and_datagrams_is_refused(house: House) -> None:
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    many = encode_poses_up([PoseUp(0, 0, n, house.clock.t, (0.0, 0.0, 0.0), NO_TURN) for n in range(200)])
    for _ in range(20):
        hear_word(house.room, alice, many)
        hear_word(house.room, bob, m.encode(m.Ranges([a_range(house)] * 200)).decode())
    assert len(house.solver.of(Pose)) == len(house.solver.of(Range)) == 2 * MEASURED_A_SECOND
    assert house.room.devices["alice"].refused == {"rate": 10}
    house.room.hear(alice, m.Module("alice", 7))
    house.room.hear(bob, m.Module("bob", 8))
    key = house.room.modules.keys.of(7)
    for n in range(2 * MEASURED_A_SECOND):
        house.room.hear_datagram(datagram(house, 7, 8, n, 5.0, 4000, key), house.clock.t)
    assert house.room.status().refused == {"datagram rate": MEASURED_A_SECOND}


def test_nobody_floods_others(house: House) -> None:
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.said_to(bob)
    for _ in range(1000):
        house.room.hear(alice, m.Say("x", 1))
        house.room.hear(alice, m.Signal("bob", {}))
    assert len(house.said_to(bob)) == 2 * HANDED_ON_A_SECOND
    house.clock.t += 60.0
    for _ in range(100):
        house.room.hear(alice, m.Say("x", "y" * 8000))
    assert len(house.said_to(bob)) == 16


def test_frames_cannot_be_begun_without_end(house: House) -> None:
    alice, _ = house.enter("alice")
    for n in range(1, 200):
        house.room.hear(alice, m.Reset("alice", n))
    assert len(house.solver.of(NewFrame)) == RESETS_AT_ONCE
    assert house.room.devices["alice"].refused == {"rate": 199 - RESETS_AT_ONCE}


def test_the_answer_is_asked_for_once_at_a_time(house: House) -> None:
    player, _ = house.enter("alice", time="recorded")
    for _ in range(100):
        house.room.hear(player, m.Finish(1.0))
    assert house.solver.finished_at == [1.0]
    house.room.finished({})
    house.room.hear(player, m.Finish(2.0))
    assert house.solver.finished_at == [1.0, 2.0]


def test_who_takes_nothing_is_let_go_before_it_fills_memory() -> None:
    outbox = Outbox()
    for _ in range(2 * MOST_BYTES // 60_000):
        outbox.put(b"x" * 60_000)
    assert outbox.overflowed
    assert sum(map(len, outbox.take())) <= MOST_BYTES


def test_all_objects_together_are_less_than_waits_for_who_comes(house: House) -> None:
    alice, _ = house.enter("alice")
    for n in range(600):
        house.room.hear(alice, m.Create(f"o{n}", "note", (0.0, 0.0, 0.0), data="x" * 8000))
    assert len(m.encode(house.room.objects.snapshot())) < 1.5 * MOST_DATA < MOST_BYTES
    assert "size" in house.room.devices["alice"].refused
    house.room.hear(alice, m.Remove("o0"))
    house.room.hear(alice, m.Create("again", "note", (0.0, 0.0, 0.0), data="x" * 8000))
    assert "again" in house.room.objects.objects


def test_not_more_look_than_can_be_told(house: House) -> None:
    for _ in range(MOST_SPECTATORS):
        house.enter()
    with pytest.raises(MessageError, match="come later"):
        house.enter()
    house.enter("alice")


# The door


def test_a_code_is_tried_as_seldom_by_any_question(lobby: Lobby) -> None:
    questions = (lobby.room, lobby.may_open, lambda code, address: lobby.join(m.Join(code), address))
    for n in range(TRIES_A_MINUTE):
        with pytest.raises(MessageError, match="no room"):
            questions[n % 3]("WRONG", "10.0.0.66")
    for ask in (lobby.room, lobby.may_open):
        with pytest.raises(MessageError, match="wait a minute"):
            ask("CODE", "10.0.0.66")


def test_tokens_are_not_sold_without_end(lobby: Lobby) -> None:
    for _ in range(JOINS_A_MINUTE):
        lobby.join(m.Join("CODE"), "10.0.0.66")
    with pytest.raises(MessageError, match="wait a minute"):
        lobby.join(m.Join("CODE"), "10.0.0.66")
    lobby.join(m.Join("CODE"), "10.0.0.2")


def test_one_network_of_ipv6_is_one_address_and_too_many_addresses_wait() -> None:
    tally = Tally(2)
    tally.count("2001:db8::1")
    tally.count("2001:db8::ffff:2")
    assert tally.full("2001:db8::3", 0.0)
    assert not tally.full("2001:db8:0:1::3", 0.0)
    for n in range(MOST_ADDRESSES):
        tally.count(f"10.{n // 65536}.{n // 256 % 256}.{n % 256}")
    assert tally.full("192.0.2.1", 0.0)
    assert not tally.full("10.0.0.1", 0.0)
    assert not tally.full("192.0.2.1", 60.0)


def test_connections_without_hello_are_few(lobby: Lobby) -> None:
    waiting = [lobby.waiting("10.0.0.66") for _ in range(MOST_WAITING_FROM_ONE)]
    for one in waiting:
        one.__enter__()
    with pytest.raises(MessageError, match="try again"), lobby.waiting("10.0.0.66"):
        pass
    with lobby.waiting("10.0.0.2"):
        pass
    for one in waiting:
        one.__exit__(None, None, None)
    with lobby.waiting("10.0.0.66"):
        pass


def test_a_token_of_a_room_that_was_closed_opens_nothing(house: House, lobby: Lobby) -> None:
    token = lobby.join(join("alice"), "10.0.0.2").token
    lobby.remove(house.room)
    with pytest.raises(MessageError, match="join again"):
        lobby.redeem(token)


def test_what_came_without_a_room_is_shown_in_every_room(house: House, lobby: Lobby) -> None:
    lobby.refused["datagram session"] += 3
    looking, _ = house.enter()
    house.room.tick()
    assert only(m.Status, house.said_to(looking)).refused == {"datagram session": 3}


@pytest.mark.parametrize(
    ("origin", "own"),
    [
        (None, True),
        ("https://192.168.1.5:47180", True),
        ("https://rooms.example.org", True),
        ("https://evil.example", False),
        ("https://192.168.1.5", False),
        ("https://192.168.1.5:47180.evil.example", False),
        ("null", False),
        ("", False),
        ("https://[", False),
    ],
)
def test_only_own_pages_come_in_from_a_browser(origin: str | None, own: bool) -> None:
    assert is_own(origin, "192.168.1.5:47180", "https://rooms.example.org/a") is own


def test_webtransport_has_a_port_of_its_own() -> None:
    assert is_own("https://192.168.1.5", "192.168.1.5:47180", any_port=True)
    assert not is_own("https://evil.example", "192.168.1.5:47180", any_port=True)


class Transport:
    def __init__(self) -> None:
        self.aborted = False

    def abort(self) -> None:
        self.aborted = True


class Connection:
    def __init__(self) -> None:
        self.transport = Transport()


def test_connections_that_ask_for_nothing_are_ended() -> None:
    silence, asks, says_nothing = Silence(), Connection(), Connection()
    silence.broken(asks)
    for now in (0.0, 9.0, 11.0):
        silence.look([asks, says_nothing], now)
    assert (asks.transport.aborted, says_nothing.transport.aborted) == (False, True)
    flood = [Connection() for _ in range(300)]
    for n in range(300):
        silence.look([asks, *flood[: n + 1]], 20.0 + 0.01 * n)
    assert [connection.transport.aborted for connection in flood] == [True] * 100 + [False] * 200


def test_a_client_is_told_of_its_own_floods_alone(house: House) -> None:
    alice, _ = house.enter("alice")
    bob, _ = house.enter("bob")
    house.said_to(bob)
    for _ in range(5 * WORDS_A_SECOND):
        hear_word(house.room, alice, "rubbish")
    assert isinstance(bob, Client)
    assert house.said_to(bob) == []
    assert len([word for word in house.said_to(alice) if isinstance(word, m.Refused)]) < 12
