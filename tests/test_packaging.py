"""What is published: the source distribution, and the version that is read from tags."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
from collections.abc import Mapping
from email import message_from_bytes
from email.message import Message
from fnmatch import fnmatch
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from support.paths import REPOSITORY

# Source that a build compiles or installs, by folder; below `synchronizar` all of it.
BUILT_FROM = {
    "bindings": {".cpp", ".h"},
    "factors": {".cpp", ".h"},
    "firmware/core": {".c", ".h"},
    "firmware/sim": {".cpp", ".h"},
    "firmware/targets/host": {".cpp", ".h"},
}
METADATA = {"pyproject.toml", "README.md", "LICENSE", "tools/long_description.py"}
BESIDE = METADATA | {"CMakeLists.txt", "firmware/CMakeLists.txt", "tests/smoke.py"}
ADDRESS = "https://forge.example/team/synchronizar"


def git(folder: Path, *arguments: str) -> str:
    named = ("-c", "user.name=Test", "-c", "user.email=test@example.org")
    return subprocess.run(
        ["git", *named, *arguments], cwd=folder, check=True, capture_output=True, encoding="utf-8"
    ).stdout


def by_the_backend(folder: Path, function: str, out: Path) -> str:
    """What a build backend's function says that it wrote into `out`."""
    code = f"import scikit_build_core.build as b; print(b.{function}({str(out)!r}))"
    run = subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, capture_output=True, encoding="utf-8")
    return run.stdout.split()[-1]


def metadata_of(folder: Path) -> Message:
    """What a wheel of a folder would say of itself."""
    with TemporaryDirectory() as out:
        made = by_the_backend(folder, "prepare_metadata_for_build_wheel", Path(out))
        return message_from_bytes((Path(out) / made / "METADATA").read_bytes())


def version_of(folder: Path) -> str:
    """The version that a wheel of a folder would have."""
    version: str = metadata_of(folder)["Version"]
    return version


def write_metadata_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """What a build's metadata are made of."""
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


def description(metadata: Message) -> str:
    payload = metadata.get_payload()
    assert isinstance(payload, str)
    return payload


@pytest.fixture(scope="module")
def sdist(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Files of the source distribution, by their paths below its one folder."""
    out = tmp_path_factory.mktemp("sdist")
    name = by_the_backend(REPOSITORY, "build_sdist", out)
    with tarfile.open(out / name) as archive:
        files = [member for member in archive.getmembers() if not member.isdir()]
        assert {member.name.split("/")[0] for member in files} == {name.removesuffix(".tar.gz")}
        return {m.name.partition("/")[2]: archive.extractfile(m).read() for m in files}  # type: ignore[union-attr]


def test_the_sdist_has_what_a_build_needs_and_nothing_else(sdist: dict[str, bytes]) -> None:
    tracked = git(REPOSITORY, "ls-files").split("\n")
    needed = {
        name
        for name in tracked
        if name.startswith("synchronizar/")
        or Path(name).suffix in BUILT_FROM.get(Path(name).parent.as_posix(), ())
        or name in BESIDE
    }
    assert needed >= BESIDE
    assert set(sdist) - {"PKG-INFO"} == needed


def test_a_container_is_built_from_as_much(sdist: dict[str, bytes]) -> None:
    lines = (REPOSITORY / ".dockerignore").read_text().split("\n")
    assert "*" in lines
    copied = [line.removeprefix("!") for line in lines if line.startswith("!")]
    left_out = {name for name in sdist if not any(fnmatch(name, at) or name.startswith(f"{at}/") for at in copied)}
    assert left_out == {"PKG-INFO", "tests/smoke.py"}


def test_the_sdist_is_small(sdist: dict[str, bytes]) -> None:
    assert sum(map(len, sdist.values())) < 5e6


def test_the_sdist_knows_its_version_without_git(sdist: dict[str, bytes], tmp_path: Path) -> None:
    write_metadata_files(tmp_path, {name: sdist[name] for name in METADATA | {"PKG-INFO"}})
    told = dict(line.split(": ", 1) for line in sdist["PKG-INFO"].decode().split("\n\n")[0].split("\n"))
    assert version_of(tmp_path) == told["Version"]


def test_the_version_comes_from_tags(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    clone.mkdir()
    named = METADATA | {".gitattributes", ".git_archival.txt"}
    write_metadata_files(clone, {name: (REPOSITORY / name).read_bytes() for name in named})
    assert version_of(clone) == "0.0"  # a bare copy

    git(clone, "init", "--quiet")
    git(clone, "add", ".")
    git(clone, "commit", "--quiet", "--message", "first")
    assert version_of(clone).startswith("0.1.dev1+g")  # a clone without tags

    git(clone, "tag", "v1.2.0")
    assert version_of(clone) == "1.2.0"

    archive = tmp_path / "archive"
    archive.mkdir()
    git(clone, "archive", "--output", str(tmp_path / "archive.tar"), "HEAD")
    with tarfile.open(tmp_path / "archive.tar") as packed:
        packed.extractall(archive, filter="data")
    assert version_of(archive) == "1.2.0"  # what a forge lets people download

    git(clone, "commit", "--quiet", "--allow-empty", "--message", "second")
    assert version_of(clone).startswith("1.2.1.dev1+g")


def test_what_the_readme_leads_to_is_reached_from_a_package_index_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    files = {name: (REPOSITORY / name).read_bytes() for name in METADATA}
    write_metadata_files(tmp_path, files)
    plain = metadata_of(tmp_path)
    assert (description(plain), plain.get_all("Project-URL")) == (readme, None)  # a clone that is nowhere published

    git(tmp_path, "init", "--quiet")
    git(tmp_path, "commit", "--quiet", "--allow-empty", "--message", "first")
    git(tmp_path, "tag", "v1.2.0")
    monkeypatch.setenv("SYNCHRONIZAR_REPOSITORY", f"{ADDRESS}/")
    released = metadata_of(tmp_path)
    assert released.get_all("Project-URL") == [f"Repository, {ADDRESS}"]
    assert released["Description-Content-Type"] == "text/markdown"
    links = re.findall(r"(!?)\[[^\]]*\]\((\S+)\)", description(released))
    assert len(links) == len(re.findall(r"\]\(", readme)) > 10
    for is_picture, link in links:
        into, name = f"{ADDRESS}/{'raw' if is_picture else 'blob'}/v1.2.0/", link.partition("/v1.2.0/")[2]
        assert link == into + name
        assert (REPOSITORY / name).exists()
    assert description(released).replace(f"{ADDRESS}/raw/v1.2.0/", "").replace(f"{ADDRESS}/blob/v1.2.0/", "") == readme

    monkeypatch.delenv("SYNCHRONIZAR_REPOSITORY")
    (tmp_path / "PKG-INFO").write_bytes(released.as_bytes())  # a wheel that is made of the sdist says the same
    from_sdist = metadata_of(tmp_path)
    assert (description(from_sdist), from_sdist.items()) == (description(released), released.items())


CHANGES = """# Changelog

## 0.3.0, unreleased

- Newest.

## 0.2.0, 2026-11-30

### Added

- This.

## 0.2.0.1, 2026-11-29
"""


def notes(version: str, changelog: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """What the tool says of a version, where this is the changelog."""
    (folder / "tools").mkdir()
    (folder / "CHANGELOG.md").write_text(changelog)
    tool = folder / "tools" / "changelog.py"
    tool.write_bytes((REPOSITORY / "tools" / "changelog.py").read_bytes())
    return subprocess.run([sys.executable, tool, version], capture_output=True, text=True, check=False)


def test_a_release_has_what_the_changelog_says_of_its_version(tmp_path: Path) -> None:
    told = notes("0.2.0", CHANGES, tmp_path)
    assert (told.returncode, told.stdout, told.stderr) == (0, "### Added\n\n- This.\n", "")


@pytest.mark.parametrize(
    ("version", "fault"), [("0.3.0", "is unreleased"), ("0.2", "has no heading"), ("0.2.0.1", "has nothing below")]
)
def test_a_version_that_the_changelog_does_not_know_is_not_released(version: str, fault: str, tmp_path: Path) -> None:
    told = notes(version, CHANGES, tmp_path)
    assert (told.returncode, told.stdout) == (1, "")
    assert told.stderr.startswith(f"CHANGELOG.md: {version} {fault}")
    assert len(told.stderr.splitlines()) == 1


def test_the_changelog_has_a_heading_for_each_version_the_newest_first() -> None:
    headings = re.findall("^## (.*)$", (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert all(re.fullmatch(r"\d+\.\d+\.\d+, (\d{4}-\d\d-\d\d|unreleased)", heading) for heading in headings)
    versions = [tuple(map(int, heading.partition(",")[0].split("."))) for heading in headings]
    assert versions == sorted(versions, reverse=True)
    assert not any(heading.endswith("unreleased") for heading in headings[1:])
