"""A server on the loopback under attack: what its door and its files give away, and what it does not wait for."""

from __future__ import annotations

import asyncio
import gzip
import json
import logging
import socket
import time
from pathlib import Path

import aiohttp
import pytest
from support.serving import run, serving

from synchronizar.live import messages as m
from synchronizar.live.certificates import make_certificate, server_context
from synchronizar.live.client import Client
from synchronizar.live.server import Server, ServerOptions


def parts(address: str) -> tuple[str, str]:
    base, _, code = address.partition("/#")
    return base, code


@pytest.mark.parametrize("path", ["/live", "/api/join", "/api/qr", "/api/rooms"])
def test_a_page_from_elsewhere_does_not_come_in_with_its_visitors_browser(path: str) -> None:
    async def test() -> None:
        async with serving() as (server, address), aiohttp.ClientSession() as session:
            base, code = parts(address)
            foreign = {"Origin": "https://evil.example"}
            ask = session.get if path == "/live" else session.post
            async with ask(f"{base}{path}", headers=foreign, data=m.encode(m.Join(code))) as response:
                assert response.status == 403
                assert "Access-Control-Allow-Origin" not in response.headers
                assert "token" not in await response.text()
            assert server.lobby.refused == {"origin": 1}
            async with session.post(f"{base}/api/join", headers={"Origin": base}, data=m.encode(m.Join(code))) as own:
                assert own.status == 200
                assert own.headers["Cache-Control"] == "no-store"

    run(test)


@pytest.mark.parametrize(
    "path",
    [
        "/pages/../server.py",
        "/pages/%2e%2e/server.py",
        "/pages/..%2fserver.py",
        "/pages/%2e%2e%2f%2e%2e%2f%2e%2e%2fetc/passwd",
        "/pages//etc/passwd",
        "/pages/",
        "/pages/vendor",
        "/../../etc/passwd",
        "/api/join",
        "/.git/config",
    ],
)
def test_nothing_but_pages_can_be_read(path: str) -> None:
    async def test() -> None:
        async with serving() as (server, _):
            head = await asked(server.port, f"GET {path} HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n".encode())
            assert head.split(b" ")[1] in (b"403", b"404", b"405")
            assert b"default-src 'none'" in head

    run(test)


async def asked(port: int, request: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    answer = await asyncio.wait_for(reader.read(), 20.0)
    writer.close()
    return answer


def test_bodies_are_bounded_and_not_unpacked() -> None:
    async def test() -> None:
        async with serving() as (_, address), aiohttp.ClientSession() as session:
            base, code = parts(address)
            async with session.post(f"{base}/api/join", data=b"x" * 100_000) as response:
                assert response.status == 413
            bomb = gzip.compress(b" " * 10_000_000 + m.encode(m.Join(code)))
            assert len(bomb) < 20_000
            async with session.post(f"{base}/api/join", data=bomb, headers={"Content-Encoding": "gzip"}) as response:
                assert response.status == 400
                assert (await response.json())["reason"] == "malformed"
            async with session.ws_connect(f"{base}/live", compress=15) as words:
                assert not words.compress
                await words.send_str("x" * (m.LARGEST_MESSAGE + 1))
                assert (await words.receive()).type in (aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.CLOSED)

    run(test)


def test_browsers_are_told_to_come_by_https_alone_where_somebody_vouches_for_the_certificate(tmp_path: Path) -> None:
    own = tmp_path / "own.pem"
    own.write_bytes(make_certificate(10)[0])

    async def test() -> None:
        for certificate in (None, own):
            options = ServerOptions(host="127.0.0.1", port=0, udp_port=0, certificate=certificate)
            server = Server(options, server_context(certificate)[0])
            try:
                await server.start()
                base = f"https://127.0.0.1:{server.port}"
                async with aiohttp.ClientSession() as session, session.get(base, ssl=False) as response:
                    assert ("Strict-Transport-Security" in response.headers) is (certificate is not None)
                    assert "frame-ancestors 'none'" in response.headers["Content-Security-Policy"]
                    assert response.headers["Cross-Origin-Opener-Policy"] == "same-origin"
                    assert response.headers["X-Content-Type-Options"] == "nosniff"
                    assert "aiohttp" not in response.headers["Server"]
            finally:
                await server.close()

    run(test)


def test_a_proxy_says_for_whom_it_asks_and_nobody_else_does() -> None:
    async def test() -> None:
        for public_url, statuses in (("https://rooms.example.org/a", {404}), (None, {404, 429})):
            options = {"clock": lambda: 1000.0, "public_url": public_url}  # all within one of the lobby's minutes
            async with serving(**options) as (server, _), aiohttp.ClientSession() as session:
                seen = set()
                for n in range(40):
                    data, headers = m.encode(m.Join("WRONG")), {"X-Forwarded-For": f"1.2.3.4, 10.0.0.{n}"}
                    address = f"http://127.0.0.1:{server.port}/api/join"
                    async with session.post(address, data=data, headers=headers) as response:
                        seen.add(response.status)
                assert seen == statuses

    run(test)


def test_nobody_opens_a_room_who_is_in_none() -> None:
    async def test() -> None:
        async with serving() as (server, address), aiohttp.ClientSession() as session:
            base, _ = parts(address)
            for body in (b"", b"{}", m.encode(m.Join("WRONG"))):
                async with session.post(f"{base}/api/rooms", data=body) as response:
                    assert response.status in (400, 404)
            assert len(server.lobby.rooms) == 1

    run(test)


def test_rubbish_at_the_port_is_counted_and_shown() -> None:
    async def test() -> None:
        async with serving() as (server, address), await Client.join(address) as client:
            port = client.welcome.udp_port
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                for data in (b"", b"x", b"\xff" * 2000, bytes(64)):
                    sender.sendto(data, ("127.0.0.1", port))
            shown = await client.until(
                lambda word: isinstance(word, m.Status) and word.refused.get("datagram session", 0) == 4
            )
            assert shown is not None
            assert server.lobby.refused == {"datagram session": 4}

    run(test)


def test_secrets_are_in_no_log_no_address_and_no_recording(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str], own_state_folder: Path
) -> None:
    caplog.set_level(logging.DEBUG)
    secrets: list[str] = []
    urls: list[str] = []

    async def test() -> None:
        trace = aiohttp.TraceConfig()

        async def note(_: object, __: object, params: aiohttp.TraceRequestStartParams) -> None:
            urls.append(str(params.url))

        trace.on_request_start.append(note)
        async with serving(record=tmp_path) as (server, address):
            base, code = parts(address)
            room = server.lobby.rooms[code]
            async with aiohttp.ClientSession(trace_configs=[trace]) as session:
                asked = m.encode(m.Join(code, [m.UserSettings("alice")]))
                async with session.post(f"{base}/api/join", data=asked) as response:
                    joined = m.decode_joined(await response.read())
                for _ in range(2):  # the second time it is refused
                    async with session.ws_connect(f"{base}/live") as socket_:
                        await socket_.send_str(m.encode(m.Hello(joined.token)).decode())
                        await socket_.receive()
                        await socket_.send_str(m.encode(m.Module("alice", 7)).decode())
                        await socket_.send_str("{" + joined.token)
                        await socket_.receive()
            async with await Client.join(address, ["bob"]) as bob:
                await bob.send_pose("bob", time.time(), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0))
                await bob.say_message(m.Create("o", "coin", (0.0, 0.0, 0.0)))
                await bob.until(lambda word: isinstance(word, m.Objects))
                while room.devices["bob"].pose is None:  # until his clock is known
                    await asyncio.sleep(0.01)
                secrets.append(bob.resume)
            key = room.modules.keys.of(7)
            secrets.extend([code, joined.token, joined.resume, room.key.hex(), key.hex()])
            secrets.extend([room.devices["alice"].owner])
            secrets_raw.extend([room.key, key])

    secrets_raw: list[bytes] = []
    run(test)
    out, err = capfd.readouterr()
    files = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {"bob.tum", "objects.sqlite3", "recording.toml"} <= {path.name for path in files}
    everything = b"".join([path.read_bytes() + str(path).encode() for path in files])
    everything += (out + err + caplog.text + json.dumps(urls)).encode()
    for secret in [*(text.encode() for text in secrets), *secrets_raw]:
        assert secret not in everything
    for kept in own_state_folder.rglob("*.json"):
        assert kept.stat().st_mode & 0o077 == 0
