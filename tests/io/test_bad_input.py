from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.broken import BROKEN, Broken, Fault, write_good

from synchronizar.data.recording import Recording
from synchronizar.errors import InputError

FILES = ("tracks/alice.tum", "ranges.csv", "recording.toml")


def test_the_recording_that_all_broken_ones_are_made_of_is_good(tmp_path: Path) -> None:
    write_good(tmp_path / "walk")
    recording = Recording.load(tmp_path / "walk")
    assert [user.name for user in recording.users] == ["alice", "beacon", "bob"]
    assert len(recording.ranges) == 12


@pytest.mark.parametrize("broken", BROKEN, ids=lambda broken: broken.sentence)
def test_a_broken_recording_loads_or_is_told_in_one_line(broken: Broken, tmp_path: Path) -> None:
    folder = tmp_path / "walk"
    write_good(folder)
    broken.build(folder)
    if broken.fault is None:
        Recording.load(folder)
    else:
        with pytest.raises(InputError) as caught:
            Recording.load(folder)
        assert_tells(str(caught.value), folder, broken.fault)


def assert_tells(message: str, folder: Path, fault: Fault) -> None:
    where = str(folder / fault.file) + ("" if fault.line is None else f":{fault.line}") + ": "
    assert message.startswith(where)
    assert fault.words in message.removeprefix(where)
    assert_one_line(message)
    assert len(message) < len(str(folder)) + 300


@pytest.fixture(scope="module")
def good() -> Iterator[Path]:
    with tempfile.TemporaryDirectory() as folder:
        write_good(Path(folder) / "good")
        yield Path(folder) / "good"


bytes_that_matter = st.one_of(
    st.binary(max_size=12),
    st.text(alphabet="0123456789.,-+einfa#\"'[]={}\n\r\t \0_", max_size=12).map(str.encode),
)


@settings(max_examples=400, deadline=None)
@given(file=st.sampled_from(FILES), data=st.data())
def test_bytes_spliced_into_a_good_file_raise_nothing_but_an_input_error(
    good: Path, file: str, data: st.DataObject
) -> None:
    original = (good / file).read_bytes()
    start = data.draw(st.integers(0, len(original)), label="start")
    end = data.draw(st.integers(start, min(len(original), start + 40)), label="end")
    spliced = original[:start] + data.draw(bytes_that_matter, label="bytes") + original[end:]
    folder = good.parent / "spliced"
    shutil.copytree(good, folder, dirs_exist_ok=True)
    (folder / file).write_bytes(spliced)
    assert_one_line(message_of_loading(folder))


def message_of_loading(folder: Path) -> str:
    """Blank where it loads."""
    try:
        Recording.load(folder)
    except InputError as error:
        return str(error)
    return ""


def assert_one_line(message: str) -> None:
    assert len(message.splitlines()) <= 1
    assert message.isprintable()
