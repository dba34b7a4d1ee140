"""The formats that `convert` knows, by name. Their modules are imported when they are needed.

A format that comes in has a module with two functions:

    recognises(source: Source) -> bool                    whether this file or folder is of the format, by its looks
    read(path: Path, asked: Asked, progress: Progress) -> Imported

A format that goes out has a function (`module:name`), which raises InputError where the file cannot be written:

    write(path: Path, exported: Exported) -> None
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synchronizar.data.exported import Exported


@dataclass(frozen=True)
class Format:
    """A format, who reads it, and who writes it."""

    name: str
    """As `--from` and `--to` have it."""
    what: str
    """What such a file is, for a message."""
    reader: str | None = None
    """Module with `recognises` and `read`."""
    writer: str | None = None
    """`module:function`."""
    suffixes: tuple[str, ...] = ()
    """Of a file that is written: its name says the format."""
    beside: str = ""
    """How the name of a file ends that is read with its own files, and is none of them."""
    reader_extra: str = ""
    """What has to be installed to read it."""
    lists: bool = False
    """Whether its module has `listing(path, asked) -> list[str]`: what is in it, without reading all of it."""
    writer_extra: tuple[str, str] | None = None
    """What has to be installed to write it: (extra, module)."""

    def reading(self) -> Any:
        """The module that reads it."""
        if self.reader is None:
            raise LookupError(self.name)
        return import_module(self.reader)

    def writing(self) -> Callable[[Path, Exported], None]:
        """The function that writes it."""
        if self.writer is None:
            raise LookupError(self.name)
        module, _, function = self.writer.partition(":")
        found: Callable[[Path, Exported], None] = getattr(import_module(module), function)
        return found


FORMATS = (
    Format("rosbag", "a bag of ROS 1 or ROS 2", "synchronizar.convert.rosbag", reader_extra="ros", lists=True),
    Format(
        "mcap",
        "an MCAP file",
        "synchronizar.convert.mcap",
        "synchronizar.io.mcap_file:write_mcap",
        suffixes=(".mcap",),
        reader_extra="mcap,ros",
        writer_extra=("mcap", "mcap.writer"),
        lists=True,
    ),
    Format(
        "pyfg",
        "a PyFG factor graph, as CORA has it",
        "synchronizar.convert.pyfg",
        "synchronizar.convert.pyfg_out:write_pyfg",
        suffixes=(".pyfg",),
    ),
    Format("dwm1001", "a log of a DWM1001's `les` or `lec`", "synchronizar.convert.dwm1001"),
    Format("nooploop", "a log of Nooploop LinkTrack frames", "synchronizar.convert.nooploop"),
    Format("pozyx", "a log of Pozyx ranges", "synchronizar.convert.pozyx"),
    Format("euroc", "EuRoC / ASL csv: # timestamp [ns], position, quaternion w x y z", "synchronizar.convert.euroc"),
    Format("kitti", "KITTI poses, with times", "synchronizar.convert.kitti", beside="times.txt"),
    Format("phone", "poses of an ARKit or ARCore recorder", "synchronizar.convert.phones"),
    Format(
        "tum",
        "a TUM track: t x y z qx qy qz qw; of a recording a folder of them, for evo",
        "synchronizar.convert.tum",
        "synchronizar.convert.tum_out:write_tum_folder",
    ),
    Format("csv", "a table with a header", "synchronizar.convert.csv"),
    Format(
        "tf",
        "static transforms as YAML: a tf2_msgs/TFMessage",
        writer="synchronizar.convert.tf_out:write_tf_yaml",
        suffixes=(".yaml", ".yml"),
    ),
    Format(
        "ros-launch",
        "static transforms as a launch file of ROS 2",
        writer="synchronizar.convert.tf_out:write_tf_launch",
        suffixes=(".py",),
    ),
    Format(
        "rerun",
        "a file that rerun shows",
        writer="synchronizar.convert.rerun_out:write_rerun",
        suffixes=(".rrd",),
        writer_extra=("rerun", "rerun"),
    ),
)
"""In the order in which a source is recognised: what is surest first."""

READ = tuple(f.name for f in FORMATS if f.reader is not None)
WRITTEN = tuple(f.name for f in FORMATS if f.writer is not None)


def format_named(name: str) -> Format:
    """The format of that name."""
    return next(f for f in FORMATS if f.name == name)
