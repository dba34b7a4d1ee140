"""Messages to and from JSON, checked."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import msgspec

from synchronizar.live.messages.basics import LARGEST_DATA, LARGEST_MESSAGE, MessageError
from synchronizar.live.messages.from_client import FromClient, Join, OpenRoom
from synchronizar.live.messages.from_room import FromRoom, Joined

_T = TypeVar("_T")


class _Tagged(msgspec.Struct):
    type: str


_encoder = msgspec.json.Encoder()
_from_client: msgspec.json.Decoder[FromClient] = msgspec.json.Decoder(FromClient)
_from_room: msgspec.json.Decoder[FromRoom] = msgspec.json.Decoder(FromRoom)
_join = msgspec.json.Decoder(Join)
_open_room = msgspec.json.Decoder(OpenRoom)
_joined = msgspec.json.Decoder(Joined)
_tagged = msgspec.json.Decoder(_Tagged)


def encode(message: msgspec.Struct) -> bytes:
    """JSON of a message. Numbers have to be finite: JSON has no others."""
    return _encoder.encode(message)


def decode_from_client(data: bytes | str) -> FromClient:
    """What a client says. Raises MessageError for anything else."""
    return _short(_from_client, data)


def decode_from_room(data: bytes | str) -> FromRoom:
    """What a room says. Raises MessageError for anything else."""
    return _checked(_from_room, data)


def type_of(data: bytes | str) -> str | None:
    """What a message that cannot be decoded calls itself; None where it is no message at all."""
    try:
        return _tagged.decode(data).type
    except (msgspec.ValidationError, msgspec.DecodeError, UnicodeDecodeError, RecursionError):
        return None


def decode_join(data: bytes) -> Join:
    """What somebody who joins asks for. Raises MessageError for anything else."""
    return _short(_join, data)


def decode_open_room(data: bytes) -> OpenRoom:
    """What somebody who opens a room asks for. Raises MessageError for anything else."""
    return _short(_open_room, data)


def decode_joined(data: bytes) -> Joined:
    """What a room answers who joins. Raises MessageError for anything else."""
    return _checked(_joined, data)


def _short(decoder: msgspec.json.Decoder[_T], data: bytes | str) -> _T:
    if len(data) > LARGEST_MESSAGE:
        raise MessageError("size", f"a message has at most {LARGEST_MESSAGE} bytes")
    return _checked(decoder, data)


def _checked(decoder: msgspec.json.Decoder[_T], data: bytes | str) -> _T:
    """JSON refuses NaN and infinities by itself; numbers beyond a double's are infinite and refused as well."""
    try:
        return decoder.decode(data)
    except msgspec.ValidationError as error:
        raise MessageError("message", str(error)) from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise MessageError("malformed", f"not a JSON object of the protocol: {error}") from None


def data_size(data: Any) -> int:
    """Bytes of an application's data as JSON."""
    return len(_encoder.encode(data))


def data_too_large(data: Any) -> bool:
    """Whether an application's data has more than LARGEST_DATA bytes as JSON."""
    return data_size(data) > LARGEST_DATA


def all_finite(*numbers: float) -> bool:
    """Whether all are finite."""
    return all(map(math.isfinite, numbers))
