"""The client without asyncio, against a server on the loopback; a recording's time, so that nothing waits."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Any

import pytest
from live.test_server import run, serving

import synchronizar as sz
from synchronizar.errors import InputError
from synchronizar.live import BlockingClient, Client
from synchronizar.live import messages as m
from synchronizar.live.pose_wire import PosesDown

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def beside_a_server(blocking: Callable[[str], None]) -> None:
    """Run what blocks in a thread; the server has the loop."""

    async def test() -> None:
        async with serving() as (_, address):
            await asyncio.to_thread(blocking, address)

    run(test)


def test_it_says_poses_and_ranges_and_hears_frames_and_poses() -> None:
    def blocking(address: str) -> None:
        with BlockingClient.join(address, ["alice", "bob"], up="y", time="recorded") as client:
            assert client.welcome.you == ["alice", "bob"]
            for i in range(41):
                client.send_pose("alice", 0.1 * i, (0.05 * i, 0.0, 0.0), UPRIGHT)
                client.send_poses([("bob", 0.1 * i, (0.0, 0.0, 0.05 * i), UPRIGHT)])
                client.send_range(0.1 * i, "alice", "bob", 2.0, sigma=0.2)
            client.say_message(m.Clock(4.0))
            client.until(lambda said: isinstance(said, m.Frames) and said.users["alice"].state == "registered", 60.0)
            assert client.frames.users["alice"].matrix is not None
            client.until(lambda said: isinstance(said, PosesDown) and len(said.poses) > 0, 60.0)
            assert client.poses is not None
            assert client.members["alice"].up == "y"
            assert client.refused == {}

    beside_a_server(blocking)


def test_what_is_told_once_waits_in_order_until_it_is_asked_for() -> None:
    def blocking(address: str) -> None:
        with BlockingClient.join(address) as looks, BlockingClient.join(address, ["alice"]) as alice:
            alice.say_message(m.Say("chat", 1))
            alice.say_message(m.Say("chat", 2))
            alice.say_message(m.Create("cube", "cube", (0.0, 1.0, 2.0)))
            told = []
            for message in looks.messages(timeout=60.0):
                told.append(message)
                if isinstance(message, m.Objects):
                    break
            assert [message.data for message in told if isinstance(message, m.Said)] == [1, 2]
            assert looks.objects["cube"].position == (0.0, 1.0, 2.0)
            assert not any(isinstance(message, (m.Frames, m.Status)) for message in told)
            assert list(looks.messages(timeout=0.0)) == []

    beside_a_server(blocking)


def test_an_answer_that_came_before_it_was_waited_for_is_there_once() -> None:
    def blocking(address: str) -> None:
        with BlockingClient.join(address, ["alice"]) as client:
            client.say_message(m.Module("alice", 7))
            client.until(lambda said: isinstance(said, m.Frames), 60.0)  # words come in order: the key is there
            key = client.until(lambda said: isinstance(said, m.ModuleKey), 60.0)
            assert isinstance(key, m.ModuleKey)
            assert key.address == 7
            assert not any(isinstance(message, m.ModuleKey) for message in client.messages(timeout=0.0))

    beside_a_server(blocking)


def test_who_waits_hears_that_the_connection_has_ended() -> None:
    def blocking(address: str) -> None:
        first = BlockingClient.join(address, ["alice"])
        with BlockingClient.join(address, ["alice"], resume=first.resume):
            assert isinstance(list(first.messages(timeout=60.0))[-1], m.Bye)
        with pytest.raises(ConnectionError):
            first.until(lambda _: False, 60.0)
        with pytest.raises(ConnectionError):
            first.send_pose("alice", 0.0, (0.0, 0.0, 0.0), UPRIGHT)
        assert first.ended
        first.close()

    beside_a_server(blocking)


def test_closing_frees_who_waits_in_another_thread_and_can_be_said_twice() -> None:
    def blocking(address: str) -> None:
        client = BlockingClient.join(address, ["alice"])
        raised: list[type[BaseException]] = []

        def waits() -> None:
            try:
                client.until(lambda _: False)
            except BaseException as error:
                raised.append(type(error))

        thread = threading.Thread(target=waits)
        thread.start()
        client.until(lambda said: isinstance(said, m.Frames), 60.0)
        client.close()
        client.close()
        thread.join(60.0)
        assert raised == [ConnectionError]
        assert not any(other.name == "synchronizar client" for other in threading.enumerate())

    beside_a_server(blocking)


def test_a_condition_that_fails_is_told_to_who_made_it_and_time_runs_out() -> None:
    def blocking(address: str) -> None:
        def wrong(_: Any) -> bool:
            raise KeyError("carol")

        with BlockingClient.join(address) as client:
            with pytest.raises(KeyError, match="carol"):
                client.until(wrong, 60.0)
            with pytest.raises(TimeoutError):
                client.until(lambda _: False, 0.01)
            assert not client.ended

    beside_a_server(blocking)


def test_a_room_that_is_not_there_is_said_and_leaves_no_thread() -> None:
    with pytest.raises(InputError, match="is no room's address"):
        sz.live.BlockingClient.join("somewhere")
    assert not any(thread.name == "synchronizar client" for thread in threading.enumerate())


def test_leaving_is_for_good() -> None:
    def blocking(address: str) -> None:
        client = BlockingClient.join(address, ["alice"])
        client.leave()
        with BlockingClient.join(address) as looks:
            assert not looks.members["alice"].here

    beside_a_server(blocking)


def test_stamps_are_by_whatever_clock_the_client_is_told() -> None:
    """A clock that is an hour behind the room's: pings are by it too, or no pose would be believed."""

    async def test() -> None:
        async with serving() as (server, address):
            (room,) = server.lobby.rooms.values()

            def clock() -> float:
                return room.now() - 3600.0

            async with await Client.join(address, ["alice"], clock=clock) as client:
                await client.until(lambda said: isinstance(said, m.Pong))
                await client.send_pose("alice", clock(), (0.0, 0.0, 0.0), UPRIGHT)
                await client.until(lambda said: isinstance(said, m.Pong))
                assert client.refused == {}
                assert client.offset == pytest.approx(3600.0, abs=10.0)
                assert room.devices["alice"].pose is not None

    run(test)
