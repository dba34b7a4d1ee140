"""Whom a client believes: a certificate that the system knows, or the one that it met there first."""

from __future__ import annotations

import asyncio
import json
import ssl
from hashlib import sha256
from pathlib import Path

import aiohttp

from synchronizar.errors import InputError
from synchronizar.live.certificates import state_folder

_KNOWN = "known_servers.json"


async def trust(host: str, port: int) -> ssl.SSLContext | aiohttp.Fingerprint:
    """How to verify a server. Raises InputError where it is not the one that was met there before."""
    context = ssl.create_default_context()
    try:
        await _certificate(host, port, context)
    except ssl.SSLCertVerificationError:
        pass
    except OSError as error:
        raise InputError(f"{host}:{port}", f"cannot be reached: {error.strerror or error}") from error
    else:
        return context
    any_context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    any_context.check_hostname, any_context.verify_mode = False, ssl.CERT_NONE
    digest = sha256(await _certificate(host, port, any_context)).hexdigest()
    path, place = state_folder() / _KNOWN, f"{host}:{port}"
    known = _read(path)
    if known.setdefault(place, digest) != digest:
        raise InputError(place, f"its certificate is another one than before; if that is right, remove it from {path}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.write_text(json.dumps(known, indent=1), encoding="utf-8")
    except OSError:
        pass  # it is asked again the next time
    return aiohttp.Fingerprint(bytes.fromhex(digest))


async def _certificate(host: str, port: int, context: ssl.SSLContext) -> bytes:
    """In DER, as a server shows it."""
    _, writer = await asyncio.open_connection(host, port, ssl=context, server_hostname=host)
    try:
        shown = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    finally:
        writer.close()
    return bytes(shown)


def _read(path: Path) -> dict[str, str]:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {str(k): str(v) for k, v in known.items()} if isinstance(known, dict) else {}
