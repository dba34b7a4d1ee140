"""`serve` and `play` as people type them, over TLS with the certificate that is made at the first start."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.surveyed import CORNERS, among

from synchronizar.cli import main
from synchronizar.geometry import YawFrame
from synchronizar.simulation.simulate import Scene

ANY_PORTS = ("--host", "127.0.0.1", "--port", "0", "--udp-port", "0")


@contextmanager
def serve(*options: str) -> Iterator[tuple[subprocess.Popen[str], dict[str, Any]]]:
    command = [sys.executable, "-m", "synchronizar", "serve", *ANY_PORTS, "--json", *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process, json.loads(process.stdout.readline())
        finally:
            process.kill()


def refused(capsys: pytest.CaptureFixture[str], *argv: str) -> str:
    assert main(argv) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    return said.err


def test_a_recording_joins_a_server_and_is_told_where_its_devices_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], own_state_folder: Path
) -> None:
    walk = str(tmp_path / "walk")
    assert main(["simulate", walk, "--users", "2", "--seconds", "6", "--seed", "4"]) == 0
    with serve() as (process, where):
        assert where.keys() == {"url", "room", "join", "udp_port"}
        assert where["join"] == f"{where['url']}/#{where['room']}"
        assert where["url"].startswith("https://")
        capsys.readouterr()
        assert main(["play", walk, where["join"], "--speed", "1000", "--json"]) == 0
        answer = json.loads(capsys.readouterr().out)
        assert {"reference", "users", "ranges", "seconds", "findings"} <= answer.keys()
        assert answer["users"].keys() == {"phone0", "phone1"}
        assert "room" in refused(capsys, "play", walk, f"{where['url']}/#WRONG")
        assert "already" in refused(capsys, "play", walk, where["join"])
        # Another certificate at the same place is somebody else's, or a server that was set up anew.
        known = own_state_folder / "synchronizar" / "known_servers.json"
        known.write_text(json.dumps(dict.fromkeys(json.loads(known.read_text()), "00" * 32)))
        assert "known_servers.json" in refused(capsys, "play", walk, where["join"])
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=120.0)
        assert (process.returncode, out, err) == (0, "", "")


def test_people_among_surveyed_radios_on_a_map_join_a_room(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The survey's zero is 5.4 million metres away, and so are the tracks' own."""
    origin = (405000.25, 5412345.5, 30.0)
    simulation = among(Scene(users=2, seconds=10.0, seed=6, rate_hz=5.0), CORNERS, origin=origin)
    own = {name: YawFrame(*origin) @ track.position for name, track in simulation.recording.tracks.items()}
    tracks = {name: replace(track, position=own[name]) for name, track in simulation.recording.tracks.items()}
    walk = tmp_path / "walk"
    replace(simulation.recording, tracks=tracks).save(walk)
    with serve() as (_, where):
        assert main(["play", str(walk), where["join"], "--speed", "1000", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["reference"] == "survey"
    for name, position in own.items():
        user = answer["users"][name]
        assert user["state"] == "registered"
        here = np.array(user["matrix"]) @ np.append(position[-1], 1.0)
        assert np.linalg.norm(here[:3] - simulation.truth[name].position[-1]) < 0.3


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (["--no-tls"], "--no-tls"),
        (["--resume"], "--record"),
        (["--port", "70000"], "--port"),
        (["--certificate", "nowhere.pem"], "nowhere.pem"),
    ],
)
def test_options_of_serve_that_cannot_be_are_told_in_one_line(
    options: list[str], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert line in refused(capsys, "serve", *options)


def test_a_port_that_is_taken_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        port = str(taken.getsockname()[1])
        assert "choose another" in refused(capsys, "serve", *ANY_PORTS, "--no-tls", "--port", port)
        udp.bind(("127.0.0.1", 0))
        port = str(udp.getsockname()[1])
        assert "--udp-port" in refused(capsys, "serve", *ANY_PORTS, "--no-tls", "--udp-port", port)


def test_a_server_that_is_not_there_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk = str(tmp_path / "walk")
    assert main(["simulate", walk, "--users", "2", "--seconds", "2"]) == 0
    capsys.readouterr()
    assert "127.0.0.1:9" in refused(capsys, "play", walk, "https://127.0.0.1:9/#ABCD")
    assert "looks like" in refused(capsys, "play", walk, "127.0.0.1")
    assert "--speed" in refused(capsys, "play", walk, "https://127.0.0.1:9/#ABCD", "--speed", "0")
