"""A room's objects on disk: a table of sqlite3, written in one transaction a second."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import msgspec

from synchronizar.errors import InputError
from synchronizar.live.messages import Object

OBJECTS_FILE = "objects.sqlite3"
_decoder = msgspec.json.Decoder(Object)


class ObjectFile:
    """Takes changes at any time; `flush` writes them, from any one thread at a time."""

    def __init__(self, path: Path) -> None:
        """Raises InputError where the file cannot be opened or is something else."""
        self._path = path
        self._changed: dict[str, bytes | None] = {}
        try:
            self._table = sqlite3.connect(path, check_same_thread=False)
            with self._table:
                self._table.execute("CREATE TABLE IF NOT EXISTS objects (id TEXT PRIMARY KEY, json BLOB NOT NULL)")
        except sqlite3.Error as error:
            raise InputError(path, f"cannot hold the room's objects: {error}") from error

    def save(self, changed: Object | str) -> None:
        """An object as it now stands, or the id of one that is gone."""
        if isinstance(changed, str):
            self._changed[changed] = None
        else:
            self._changed[changed.id] = msgspec.json.encode(changed)

    def flush(self) -> None:
        """On disk. Raises InputError where that cannot be; what was to be written is tried again the next time."""
        changed, self._changed = self._changed, {}
        if not changed:
            return
        gone = [(id_,) for id_, json in changed.items() if json is None]
        here = [(id_, json) for id_, json in changed.items() if json is not None]
        try:
            with self._table:
                self._table.executemany("DELETE FROM objects WHERE id = ?", gone)
                self._table.executemany("INSERT OR REPLACE INTO objects VALUES (?, ?)", here)
        except sqlite3.Error as error:
            self._changed = changed | self._changed
            raise InputError(self._path, f"objects cannot be written: {error}") from error

    def load(self) -> list[Object]:
        """All that are on disk. Raises InputError where one cannot be read."""
        try:
            rows = self._table.execute("SELECT json FROM objects ORDER BY id").fetchall()
            return [_decoder.decode(json) for (json,) in rows]
        except (sqlite3.Error, msgspec.DecodeError) as error:
            raise InputError(self._path, f"objects cannot be read: {error}") from error

    def close(self) -> None:
        """Nothing more comes."""
        self._table.close()
