"""Reads Nooploop LinkTrack logs: frames as a module's serial port sends them, and ROS's text of them.

| | |
|---|---|
| frames | NodeFrame2, 3, 5, AoA NodeFrame0, TagFrame0, AnchorFrame0 (`nlink`); broken ones are skipped and counted |
| text | `rostopic echo` of nlink_parser's node and tag frames (`nooploop_text`) |
| time | frames: s of the network's time since its modules were switched on; `--time-offset` shifts it to the tracks' |
| | text: `%time` or `secs`, else the same in ms |
| units | mm and -0.5 dBm in frames; m and dBm in text |
| names | ids; `anchor0`, ... of anchors that frames count from 0; `--user` for the module that ranges |
| not read | positions that modules have estimated |
| refused | a file without a whole frame, or without a range; text with a value that is no number |
"""

from __future__ import annotations

from pathlib import Path

from synchronizar.convert import nooploop_text
from synchronizar.convert.asked import Asked
from synchronizar.convert.imported import Imported
from synchronizar.convert.logs import OWN_CLOCK, Log
from synchronizar.convert.nlink import MARKS, Frames, begins_with_frames
from synchronizar.convert.source import Source
from synchronizar.errors import InputError, os_faults
from synchronizar.progress import Progress

_STEP = 2000


def recognises(source: Source) -> bool:
    """Frames, or text of nlink_parser's fields."""
    return nooploop_text.recognises(source) if source.is_text else begins_with_frames(source.head)


def read(path: Path, asked: Asked, progress: Progress) -> Imported:
    """Ranges of a node or a tag to others. Raises InputError where there is none."""
    if Source.of(path).is_text:
        return nooploop_text.read(path, asked, progress)
    with os_faults(path):
        data = path.read_bytes()
    log, frames = Log(path, asked, "m"), Frames(data)
    for count, (end, found) in enumerate(frames.ranges()):
        for r in found:
            if r.distance > 0.0:
                log.add(r.t, asked.user or r.a, r.b, r.distance, rx_power=r.rx_power, fp_power=r.fp_power)
        if count % _STEP == 0:
            progress(end / len(data))
    if not frames.count:
        marks = ", ".join(f"0x{mark:02x}" for mark in sorted(MARKS))
        raise InputError(path, f"has no whole frame: 0x55, one of {marks}, ..., and the sum of it all")
    if not len(log.imported.ranges):
        raise InputError(path, f"has {frames.count} frames, and no range in any of them")
    if frames.skipped:
        log.imported.note(f"{frames.skipped} of {len(data)} bytes of {path.name} are of broken frames, and skipped")
    log.imported.note(OWN_CLOCK)
    return log.imported
