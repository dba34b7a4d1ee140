"""What stands at the place that is to be converted, as far as it takes to recognise its format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from synchronizar.errors import os_faults

HEAD_BYTES = 16384
HEAD_LINES = 50


@dataclass(frozen=True)
class Source:
    """A file or a folder, and how it begins."""

    path: Path
    is_folder: bool
    head: bytes
    """The first bytes of a file."""
    names: tuple[str, ...]
    """What a folder holds, sorted."""

    @classmethod
    def of(cls, path: Path) -> Source:
        """Raises InputError where nothing can be read there."""
        with os_faults(path):
            if path.is_dir():
                return cls(path, True, b"", tuple(sorted(p.name for p in path.iterdir())))
            with path.open("rb") as file:
                return cls(path, False, file.read(HEAD_BYTES), ())

    @property
    def suffix(self) -> str:
        """Of a file's name, in small letters."""
        return "" if self.is_folder else self.path.suffix.lower()

    @property
    def is_text(self) -> bool:
        """Whether it is a file of text."""
        return not self.is_folder and b"\0" not in self.head

    @property
    def lines(self) -> list[str]:
        """Its first whole lines that are not blank, without what surrounds them; none where it is not text."""
        if not self.is_text:
            return []
        lines = self.head.decode("utf-8-sig", errors="replace").splitlines()
        if len(self.head) == HEAD_BYTES:
            lines = lines[:-1]
        return [line.strip() for line in lines if line.strip()][:HEAD_LINES]
