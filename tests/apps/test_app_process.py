"""An application in its own process, with a server and a recording that is played."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from types import SimpleNamespace

import aiohttp
import pytest
from support.serving import run, serving

from synchronizar.apps.catch.game import BALL
from synchronizar.errors import InputError
from synchronizar.live import app_process
from synchronizar.live.app_process import AppProcess
from synchronizar.live.app_run import Place
from synchronizar.live.applications import application, installed
from synchronizar.live.client import Client
from synchronizar.live.play import play
from synchronizar.live.restarts import FIRST_WAIT_S
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_catch_runs_in_a_room_whose_devices_a_recording_plays() -> None:
    walk = simulate(Scene(users=3, seconds=10.0, seed=4, up="y")).recording

    async def test() -> None:
        async with serving(app="catch") as (_, address), await Client.join(address) as looks:
            assert looks.welcome.app == "catch"
            await asyncio.gather(play(walk, address, 1e9), looks.until(lambda _: BALL in looks.objects))
            assert looks.objects[BALL].holder == "app"
            assert looks.objects[BALL].data == {"phase": "held", "by": min(walk.tracks)}

    run(test)


def test_pages_and_a_list_of_applications_are_served() -> None:
    async def test() -> None:
        async with serving() as (server, address), aiohttp.ClientSession() as session:
            base = address.partition("#")[0].rstrip("/")
            async with session.get(f"{base}/api/apps") as answer:
                assert (await answer.json())["catch"]["title"] == "Catch"
            async with session.get(f"{base}/apps/catch/phone.js") as answer:
                assert answer.status == 200
                assert "javascript" in answer.content_type
            async with session.get(f"{base}/apps/catch/../game.py") as answer:
                assert answer.status == 404
            code = address.partition("#")[2]
            async with session.post(f"{base}/api/rooms", json={"room": code, "app": "catch"}) as answer:
                opened = await answer.json()
            assert server.lobby.rooms[opened["room"]].app == "catch"
            async with session.post(f"{base}/api/rooms", json={"room": code, "app": "nothing"}) as answer:
                assert answer.status == 503
                assert "no application" in (await answer.json())["what"]

    run(test)


def test_an_application_that_ends_is_begun_again_after_a_pause_that_is_told() -> None:
    told: list[str] = []

    async def test() -> None:
        place = Place("http://127.0.0.1:1/#ABCD2345", "secret", None)
        keeper = AppProcess("catch", place, told.append, clock=lambda: 1000.0)  # however long it takes to end
        keeper.start()
        while len(told) < 2:
            await asyncio.sleep(0.05)
        await keeper.close()

    run(test)
    assert f"begun again in {FIRST_WAIT_S:g} s" in told[0]
    assert f"begun again in {2.0 * FIRST_WAIT_S:g} s" in told[1]


def test_one_that_ends_just_when_it_is_to_be_killed_has_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[str] = []

    async def wait() -> None:
        waits.append("waits")
        if len(waits) == 1:
            await asyncio.sleep(3600.0)

    def kill() -> None:
        raise ProcessLookupError

    async def test() -> None:
        keeper = AppProcess("catch", Place("http://127.0.0.1:1/#ABCD2345", "secret", None), print)
        stdin = SimpleNamespace(close=lambda: None)
        keeper._process = SimpleNamespace(returncode=None, stdin=stdin, wait=wait, kill=kill)  # type: ignore[assignment]
        await keeper.close()

    monkeypatch.setattr(app_process, "_ENDS_WITHIN_S", 0.01)
    run(test)
    assert len(waits) == 2


def test_an_application_that_there_is_not_is_refused_by_name() -> None:
    with pytest.raises(InputError, match=r"no application 'nothing'; there are: .*catch"):
        application("nothing")


def test_anybody_can_install_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a wheel leaves it: a module, and its entry point beside it."""
    (tmp_path / "bell.py").write_text(
        "from synchronizar.live.applications import Application\n\n\n"
        "class Bell(Application):\n    title, summary = 'Bell', 'It rings.'\n"
    )
    metadata = tmp_path / "bell-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: bell\nVersion: 1.0\n")
    points = "bell = bell:Bell\nbad = bell:nothing\nno = json:dumps\n"
    (metadata / "entry_points.txt").write_text(f"[synchronizar.apps]\n{points}")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert {"bell", "catch"} <= installed().keys()
    assert application("bell").title == "Bell"
    for name in ("bad", "no"):
        with pytest.raises(InputError, match=name):
            application(name)
    sys.modules.pop("bell", None)
