"""Recordings as the world has them: each a sentence, how to make it from a good one, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

POSES = 12
ALICE = "".join(f"{k / 2} {0.3 * k} {0.02 * k * k} 0 0 0 0 1\n" for k in range(POSES))
BOB = "".join(f"{k / 2} {-0.1 * k * k} {0.2 * k} 0.1 0 0 0.6 0.8\n" for k in range(POSES))
RANGES = "t,a,b,range,sigma\n" + "".join(
    f"{k / 2},{('alice,bob', 'bob,beacon')[k % 2]},{3.0 + 0.1 * k},0.1\n" for k in range(POSES)
)
TOML = """up = "z"

[users.alice]
height_sigma = 0.2
antennas.front = [0.1, 0.0, 0.05]

[users.beacon]
static = true
"""

Build = Callable[[Path], object]


class Fault(NamedTuple):
    """What the one line must name."""

    file: str
    line: int | None
    words: str


class Broken(NamedTuple):
    """One recording that is not as it should be."""

    sentence: str
    build: Build
    """Changes a good recording in the folder."""
    fault: Fault | None
    """None: it can be used all the same."""


def write_good(folder: Path) -> None:
    """Two walkers and a beacon."""
    (folder / "tracks").mkdir(parents=True)
    (folder / "tracks/alice.tum").write_text(ALICE)
    (folder / "tracks/bob.tum").write_text(BOB)
    (folder / "ranges.csv").write_text(RANGES)
    (folder / "recording.toml").write_text(TOML)


def content(file: str, data: str | bytes) -> Build:
    """The whole file is this instead."""
    raw = data.encode() if isinstance(data, str) else data
    return lambda folder: (folder / file).write_bytes(raw)


def line(file: str, number: int, text: str) -> Build:
    """That line, counted from 1, is this instead."""

    def build(folder: Path) -> None:
        lines = (folder / file).read_text().split("\n")
        lines[number - 1] = text
        (folder / file).write_text("\n".join(lines))

    return build


def appended(file: str, data: str | bytes) -> Build:
    """This stands at the end of the file."""
    raw = data.encode() if isinstance(data, str) else data

    def build(folder: Path) -> None:
        (folder / file).write_bytes((folder / file).read_bytes() + raw)

    return build


def removed(*files: str) -> Build:
    """Without these files."""

    def build(folder: Path) -> None:
        for file in files:
            (folder / file).unlink()

    return build


def folder_instead(file: str) -> Build:
    """A folder has the file's name."""

    def build(folder: Path) -> None:
        (folder / file).unlink()
        (folder / file).mkdir()

    return build


def link_to_itself(file: str) -> Build:
    """A file that the system cannot open, whoever asks."""

    def build(folder: Path) -> None:
        (folder / file).unlink()
        (folder / file).symlink_to(file.rpartition("/")[2])

    return build


def missing_folder(folder: Path) -> None:
    removed("tracks/alice.tum", "tracks/bob.tum", "ranges.csv", "recording.toml")(folder)
    (folder / "tracks").rmdir()
    folder.rmdir()


def file_for_folder(folder: Path) -> None:
    missing_folder(folder)
    folder.write_text("not a folder")


def empty_folder(folder: Path) -> None:
    missing_folder(folder)
    folder.mkdir()


def no_tracks_folder(folder: Path) -> None:
    removed("tracks/alice.tum", "tracks/bob.tum")(folder)
    (folder / "tracks").rmdir()


def no_tracks_at_all(folder: Path) -> None:
    no_tracks_folder(folder)
    removed("recording.toml")(folder)


def file_for_tracks_folder(folder: Path) -> None:
    no_tracks_folder(folder)
    (folder / "tracks").write_text("")


def control_characters_in_a_name(folder: Path) -> None:
    (folder / "tracks/bob.tum").rename(folder / "tracks/b\tob.tum")


def bytes_that_are_no_text_in_a_name(folder: Path) -> None:
    (folder / "tracks/bob.tum").rename(folder / "tracks" / b"b\xffb.tum".decode("utf-8", "surrogateescape"))


def shuffled(file: str, header_lines: int) -> Build:
    """The lines after the header stand in another order."""

    def build(folder: Path) -> None:
        lines = (folder / file).read_text().splitlines(keepends=True)
        head, rows = lines[:header_lines], lines[header_lines:]
        (folder / file).write_text("".join(head + rows[1::2] + rows[::-2]))

    return build


A, B, R, T = "tracks/alice.tum", "tracks/bob.tum", "ranges.csv", "recording.toml"
GARBAGE = bytes(range(256)) * 20

BROKEN = [
    # The folder
    Broken("the folder is missing", missing_folder, Fault("", None, "No such file")),
    Broken("a file stands where the folder should be", file_for_folder, Fault("", None, "Not a directory")),
    Broken("the folder is empty", empty_folder, Fault("", None, "no tracks")),
    Broken("there are neither tracks nor static users", no_tracks_at_all, Fault("", None, "no tracks")),
    Broken("there is no tracks folder but users with settings", no_tracks_folder, Fault(T, None, "alice has no track")),
    Broken("a file stands where the tracks folder should be", file_for_tracks_folder, Fault("tracks", None, "Not a")),
    Broken("a folder stands in a track's place", folder_instead(A), Fault(A, None, "Is a directory")),
    Broken("a folder stands in the ranges' place", folder_instead(R), Fault(R, None, "Is a directory")),
    Broken("a folder stands in the settings' place", folder_instead(T), Fault(T, None, "Is a directory")),
    Broken("a track cannot be opened", link_to_itself(A), Fault(A, None, "symbolic links")),
    Broken("the ranges cannot be opened", link_to_itself(R), Fault(R, None, "symbolic links")),
    Broken("the settings cannot be opened", link_to_itself(T), Fault(T, None, "symbolic links")),
    Broken("the ranges are missing", removed(R), Fault(R, None, "No such file")),
    Broken("the settings are missing and a range names the beacon", removed(T), Fault(R, 3, "'beacon'")),
    Broken("a user's name has a control character", control_characters_in_a_name, Fault("tracks", None, "name of a")),
    Broken("a user's name is no text", bytes_that_are_no_text_in_a_name, Fault("tracks", None, "name of a")),
    Broken("a hidden file lies among the tracks", lambda f: (f / "tracks/._bob.tum").write_bytes(GARBAGE), None),
    Broken("another file lies among the tracks", lambda f: (f / "tracks/notes.txt").write_bytes(GARBAGE), None),
    # Tracks
    Broken("a track is empty", content(A, ""), Fault(A, None, "no pose")),
    Broken("a track has comments alone", content(A, "# t x y z\n\n"), Fault(A, None, "no pose")),
    Broken("a track has one pose", content(A, "0 0 0 0 0 0 0 1\n"), None),
    Broken("a track ends in the middle of a line", content(A, ALICE[:-6]), Fault(A, POSES, "here are 5")),
    Broken("a track lacks its last line's end", content(A, ALICE[:-1]), None),
    Broken("a track has comments and blank lines", content(A, "# t x y z\n\n" + ALICE + "  # end\n\n"), None),
    Broken("a track has Windows' line ends and a BOM", content(A, "\ufeff" + ALICE.replace("\n", "\r\n")), None),
    Broken(
        "a track is separated by commas",
        content(A, ALICE.replace(" ", ",")),
        Fault(A, 1, "by spaces"),
    ),
    Broken("a track is binary garbage", content(A, GARBAGE), Fault(A, 1, "here are")),
    Broken("a track has garbage at its end", appended(A, GARBAGE), Fault(A, POSES + 1, "here are")),
    Broken("a comment in a track is not UTF-8", content(A, b"# caf\xe9\n" + ALICE.encode()), None),
    Broken(
        "a number in a track is not UTF-8", appended(A, b"9 0 0 \xe9 0 0 0 1\n"), Fault(A, POSES + 1, "not a number")
    ),
    Broken("a number in a track is NUL", appended(A, b"9 0 0 \x00 0 0 0 1\n"), Fault(A, POSES + 1, "not a number")),
    Broken("a number in a track is a word", line(A, 3, "1 0 0 up 0 0 0 1"), Fault(A, 3, "'up' is not a number")),
    Broken("a number in a track is grouped", line(A, 3, "1 1_0 0 0 0 0 0 1"), Fault(A, 3, "'1_0' is not a number")),
    Broken("a position is NaN", line(A, 4, "1.5 nan 0 0 0 0 0 1"), Fault(A, 4, "not finite")),
    Broken("a stamp is inf", line(A, 5, "inf 0 0 0 0 0 0 1"), Fault(A, 5, "not finite")),
    Broken(
        "a quaternion is NaN, after a comment", content(A, f"# c\n\n{ALICE}9 0 0 0 nan 0 0 1"), Fault(A, 15, "finite")
    ),
    Broken("a position is 1e300", line(A, 6, "2.5 1e300 0 0 0 0 0 1"), Fault(A, 6, "1e+07 m")),
    Broken("a stamp is 1e300", line(A, 6, "1e300 0 0 0 0 0 0 1"), Fault(A, 6, "seconds")),
    Broken("a number overflows", line(A, 6, "2.5 1e999 0 0 0 0 0 1"), Fault(A, 6, "not finite")),
    Broken("a stamp is in milliseconds", line(A, 1, "1700000000000 0 0 0 0 0 0 1"), Fault(A, 1, "seconds")),
    Broken("a quaternion is zero", line(A, 7, "3 0 0 0 0 0 0 0"), Fault(A, 7, "zero")),
    Broken("a quaternion is tiny", line(A, 7, "3 0 0 0 0 0 0 1e-320"), None),
    Broken("a quaternion is huge", line(A, 7, "3 0 0 0 1e300 0 0 1e300"), None),
    Broken("a track has seven columns", content(A, ALICE.replace(" 0 1\n", " 1\n")), Fault(A, 1, "here are 7")),
    Broken("a pose has nine numbers", line(A, 8, "3.5 0 0 0 0 0 0 1 1"), Fault(A, 8, "here are 9")),
    Broken("a line of a track is huge", line(A, 2, "1 " * 500_000), Fault(A, 2, "here are 500000")),
    Broken("a number of a track is huge", line(A, 2, f".5 0 0 {'x' * 500_000} 0 0 0 1"), Fault(A, 2, "not a number")),
    Broken("every pose has the same stamp", content(A, "".join(f"1 {k} 0 0 0 0 0 1\n" for k in range(9))), None),
    Broken("a track's lines are shuffled", shuffled(A, 0), None),
    Broken("a track's lines all stand twice", content(A, ALICE * 2), None),
    Broken(
        "a track and the ranges do not overlap in time",
        content(A, "".join("864" + pose for pose in ALICE.splitlines(keepends=True))),
        None,
    ),
    # Ranges
    Broken("the ranges are empty", content(R, ""), Fault(R, None, "header")),
    Broken("the ranges are blank lines", content(R, "\n \n\n"), Fault(R, None, "header")),
    Broken("the ranges are a header alone", content(R, "t,a,b,range\n"), None),
    Broken("the header is missing", content(R, RANGES.partition("\n")[2]), Fault(R, 1, "lacks t,a,b,range")),
    Broken("the ranges are separated by semicolons", content(R, RANGES.replace(",", ";")), Fault(R, 1, "it is 't;a;b")),
    Broken("the header lacks a column", line(R, 1, "t,a,b,sigma,distance"), Fault(R, 1, "lacks range")),
    Broken("the header has a column twice", line(R, 1, "t,a,b,range,range"), Fault(R, 1, "range more than once")),
    Broken("the header stands after blank lines", content(R, "\n\n" + RANGES), None),
    Broken("the columns stand in another order", content(R, "range,b, a ,t\n3.0, alice ,bob,1.0\n"), None),
    Broken("there are columns that nobody knows", content(R, "t,a,b,range,,mood\n1,bob,alice,3,,glad\n"), None),
    Broken("the ranges have Windows' line ends and a BOM", content(R, "\ufeff" + RANGES.replace("\n", "\r\n")), None),
    Broken("the ranges have blank lines", content(R, RANGES.replace("\n", "\n\n  \n")), None),
    Broken("the ranges are binary garbage", content(R, GARBAGE), Fault(R, 1, "header")),
    Broken("the ranges have garbage at their end", appended(R, GARBAGE), Fault(R, POSES + 2, "columns")),
    Broken("the ranges are UTF-16", content(R, RANGES.encode("utf-16")), Fault(R, 1, "header")),
    Broken("the ranges end in the middle of a line", content(R, RANGES[:-8]), Fault(R, POSES + 1, "here are 4")),
    Broken("a row has a column too many", line(R, 4, "1,alice,bob,3,0.1,7"), Fault(R, 4, "here are 6")),
    Broken("a quote is not closed", line(R, 4, '1,"alice,bob,3,0.1'), Fault(R, 4, "split")),
    Broken("a quote in the header is not closed", line(R, 1, '"t,a,b,range,sigma'), Fault(R, 1, "split")),
    Broken("the last quote is not closed", content(R, 't,a,b,range\n1,alice,bob,"3'), Fault(R, 2, "split")),
    Broken("names are in quotes", line(R, 4, '1,"alice","bob",3,0.1'), None),
    Broken("a value is huge", line(R, 4, f"1,alice,bob,3,{'1' * 500_000}"), Fault(R, 4, "field limit")),
    Broken("a name is huge", line(R, 4, f"1,{'bob' * 30_000},bob,3,0.1"), Fault(R, 4, "bobbob")),
    Broken("a range is a word", line(R, 5, "1,alice,bob,near,0.1"), Fault(R, 5, "'near'")),
    Broken("a range is blank", line(R, 5, "1,alice,bob,,0.1"), Fault(R, 5, "must be a number")),
    Broken("a range is grouped", line(R, 5, "1,alice,bob,1_0,0.1"), Fault(R, 5, "'1_0'")),
    Broken("a range is NaN", line(R, 5, "1,alice,bob,nan,0.1"), None),
    Broken("a range is inf", line(R, 5, "1,alice,bob,inf,0.1"), None),
    Broken("a range is 1e300", line(R, 5, "1,alice,bob,1e300,0.1"), None),
    Broken("a range is far below zero", line(R, 5, "1,alice,bob,-6000000,0.1"), None),
    Broken("a range's stamp is NaN", line(R, 5, "nan,alice,bob,3,0.1"), Fault(R, 5, "'nan'")),
    Broken("a range's stamp is 1e300", line(R, 5, "1e300,alice,bob,3,0.1"), Fault(R, 5, "seconds")),
    Broken("a range's stamp is a word", line(R, 5, "noon,alice,bob,3,0.1"), Fault(R, 5, "'noon'")),
    Broken("a range names an unknown user", line(R, 6, "1,alice,eve,3,0.1"), Fault(R, 6, "'eve'")),
    Broken("a range names nobody", line(R, 6, "1,,bob,3,0.1"), Fault(R, 6, "a is ''")),
    Broken("a range's name is not UTF-8", appended(R, b"1,alice,b\xf6b,3,0.1\n"), Fault(R, POSES + 2, "no user")),
    Broken("a range is from a user to itself", line(R, 6, "1,bob,bob,3,0.1"), Fault(R, 6, "itself")),
    Broken("a sigma is zero", line(R, 6, "1,alice,bob,3,0"), Fault(R, 6, "sigma")),
    Broken("a sigma is negative", line(R, 6, "1,alice,bob,3,-0.1"), Fault(R, 6, "sigma")),
    Broken("a sigma is inf", line(R, 6, "1,alice,bob,3,inf"), Fault(R, 6, "sigma")),
    Broken("a sigma is blank", line(R, 6, "1,alice,bob,3,"), None),
    Broken("an antenna is unknown", content(R, "t,a,b,range,antenna_a\n1,alice,bob,3,back\n"), Fault(R, 2, "front")),
    Broken("the only antenna is blank", content(R, "t,a,b,range,antenna_a\n1,alice,bob,3,\n"), None),
    Broken("a user without antennas has one named", content(R, "t,a,b,range,antenna_b\n1,alice,bob,3,left\n"), None),
    Broken(
        "several antennas and none is named",
        content(T, TOML.replace("antennas.front", "antennas.back = [0, 0, 0]\nantennas.front")),
        Fault(R, 2, "alice has the antennas back, front"),
    ),
    Broken("nlos is a word", content(R, "t,a,b,range,nlos\n1,alice,bob,3,maybe\n"), Fault(R, 2, "'maybe'")),
    Broken("the ranges' rows are shuffled", shuffled(R, 1), None),
    Broken("the ranges' rows stand twice", content(R, RANGES + RANGES.partition("\n")[2]), None),
    Broken(
        "the fault is far down", content(R, RANGES + RANGES.splitlines()[1] + "\n" * 5000 + "x"), Fault(R, 5014, "col")
    ),
    # Settings
    Broken("the settings are empty and no range needs them", content(T, "[users.beacon]\nstatic = true"), None),
    Broken("the settings are no TOML", line(T, 4, "height_sigma = = 2"), Fault(T, 4, "Invalid")),
    Broken("the settings break off", content(T, TOML + "[users.bob"), Fault(T, 9, "Expected")),
    Broken("the settings have a table twice", appended(T, "[users.alice]\n"), Fault(T, 9, "twice")),
    Broken("the settings are not UTF-8", appended(T, b"# caf\xe9\n"), Fault(T, 9, "UTF-8")),
    Broken("the settings are binary garbage", content(T, GARBAGE), Fault(T, 2, "UTF-8")),
    Broken("the settings are nested without end", content(T, "x = " + "[" * 100_000), Fault(T, None, "recursion")),
    Broken("a number of the settings is endless", content(T, "x = " + "9" * 9999), Fault(T, None, "digits")),
    Broken(
        "a setting is misspelt", line(T, 4, "hight_sigma = 0.2"), Fault(T, None, "users.alice has no setting 'hight")
    ),
    Broken("a setting at the top is misspelt", line(T, 1, 'upp = "y"'), Fault(T, None, "'upp'; there are up, users")),
    Broken("up is x", line(T, 1, 'up = "x"'), Fault(T, None, '"z" or "y"')),
    Broken("up is a number", line(T, 1, "up = 3"), Fault(T, None, '"z" or "y"')),
    Broken("a user's up is a table", line(T, 4, "up = {}"), Fault(T, None, "users.alice.up")),
    Broken("up is y", line(T, 1, 'up = "y"'), None),
    Broken("static is a word", line(T, 8, 'static = "yes"'), Fault(T, None, "users.beacon.static")),
    Broken("users is a list", content(T, "users = [1]"), Fault(T, None, "users must be a table")),
    Broken("a user is a number", content(T, "users.bob = 1"), Fault(T, None, "users.bob must be a table")),
    Broken("the height's sigma is true", line(T, 4, "height_sigma = true"), Fault(T, None, "height_sigma")),
    Broken("the height's sigma is negative", line(T, 4, "height_sigma = -1"), Fault(T, None, "height_sigma")),
    Broken("the height's sigma is NaN", line(T, 4, "height_sigma = nan"), Fault(T, None, "height_sigma")),
    Broken(
        "the height's sigma is beyond any float", line(T, 4, f"height_sigma = 1{'0' * 400}"), Fault(T, None, "height_s")
    ),
    Broken("the antennas are a list", line(T, 5, "antennas = [1, 2, 3]"), Fault(T, None, "antennas must be a table")),
    Broken("an antenna has two numbers", line(T, 5, "antennas.0 = [1, 2]"), Fault(T, None, "antennas.0")),
    Broken("an antenna has a word", line(T, 5, 'antennas.0 = [1, 2, "3"]'), Fault(T, None, "antennas.0")),
    Broken("an antenna is at inf", line(T, 5, "antennas.0 = [1, 2, inf]"), Fault(T, None, "antennas.0")),
    Broken("an antenna has a blank name", line(T, 5, 'antennas."" = [1, 2, 3]'), Fault(T, None, "name of an antenna")),
    Broken(
        "a static user has antennas", appended(T, "antennas.0 = [0, 0, 0]"), Fault(T, None, "users.beacon is static")
    ),
    Broken("a static user has a track", appended(T, "[users.bob]\nstatic = true"), Fault(B, None, "bob is static")),
    Broken("a user has neither track nor place", appended(T, "[users.eve]"), Fault(T, None, "eve has no track")),
    Broken("a user's name leads out of the folder", appended(T, '[users."../x"]'), Fault(T, None, "name of a user")),
]
