"""What is written in another format: a recording, and an answer about it where there is one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.data.track import Track
from synchronizar.data.updates import Update


@dataclass(frozen=True)
class Exported:
    """A recording, and what `register` or `replay` made of it."""

    recording: Recording
    registration: Registration | None = None
    """None: there is no answer, and neither tracks nor updates."""
    tracks: Mapping[str, Track] = field(default_factory=dict)
    """In the common frame, of those whom the answer places."""
    updates: Sequence[Update] = ()
    """Of a replay."""

    @property
    def shown(self) -> Mapping[str, Track]:
        """The tracks in the common frame; those of everybody's own SLAM where there is no answer."""
        return self.recording.tracks if self.registration is None else self.tracks
