"""The client in Node, over TLS and in real time: two of them and a server, each a program of its own."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.paths import REPOSITORY

LARGEST_ERROR_M = 0.4


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The example with its package beside it."""
    if shutil.which("npm") is None:
        pytest.skip("needs node and npm, which are not here")
    folder = tmp_path / "node_client"
    not_here = shutil.ignore_patterns("node_modules", "package-lock.json")
    shutil.copytree(REPOSITORY / "examples" / "node_client", folder, ignore=not_here)
    command = ["npm", "install", "--no-audit", "--no-fund", "--prefer-offline", "--fetch-retries=0"]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=60, check=False)
    except subprocess.TimeoutExpired:
        pytest.skip("needs the package ws, and npm's registry does not answer")
    if done.returncode != 0:
        pytest.skip(f"needs the package ws, which cannot be installed: {done.stderr.strip().splitlines()[:1]}")
    return folder


@pytest.fixture
def address() -> Iterator[str]:
    """Of a room on this machine."""
    command = [sys.executable, "-m", "synchronizar", "serve", "--json", "--host", "127.0.0.1"]
    with subprocess.Popen([*command, "--port", "0", "--udp-port", "0"], stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        yield str(json.loads(server.stdout.readline())["join"])
        server.terminate()


def test_two_walkers_in_node_find_each_other(installed: Path, address: str) -> None:
    walkers = [
        subprocess.Popen(["node", "walk.js", address, *names], cwd=installed, stdout=subprocess.PIPE, text=True)
        for names in (("alice", "bob"), ("bob", "alice"))
    ]
    try:
        for walker, peer in zip(walkers, ("bob", "alice"), strict=True):
            said, _ = walker.communicate(timeout=150)
            assert walker.returncode == 0, said
            assert f"{peer}: registered" in said
            error = re.search(r"^error: ([\d.]+) m$", said, flags=re.MULTILINE)
            assert error is not None
            assert float(error[1]) < LARGEST_ERROR_M
    finally:
        for walker in walkers:
            walker.kill()
