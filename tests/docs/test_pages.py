"""What a user reads: links that lead somewhere, and pages that leave nothing out."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from support.paths import REPOSITORY

import synchronizar
from synchronizar.cli import main

DOCS = REPOSITORY / "docs"
PAGES = sorted(
    file
    for file in REPOSITORY.rglob("*.md")
    if not set(file.relative_to(REPOSITORY).parts) & {".venv", "build", ".pytest_cache", "demo", "node_modules"}
)
WORDS_OF_README = 700


def relative_links(text: str) -> Iterator[str]:
    """Targets of a page's links that are no addresses, without the places in them; code is no link."""
    prose = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", prose):
        if not re.match(r"[a-z]+:", target) and not target.startswith("#"):
            yield target.partition("#")[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_relative_link_of_a_page_leads_to_a_file(page: Path) -> None:
    assert [link for link in relative_links(page.read_text()) if not (page.parent / link).exists()] == []


def test_links_are_found_in_prose_and_not_in_code() -> None:
    text = "[a](b.md#c) ![d](e.png) `[f](g.md)` [h](https://i) [](j/k.md)\n```\n[l](m.md)\n```\n"
    assert list(relative_links(text)) == ["b.md", "e.png", "j/k.md"]


def checked(folder: Path) -> tuple[int, str]:
    """What the checker of built pages says of a folder."""
    checker = REPOSITORY / "tools" / "check_links.py"
    done = subprocess.run([sys.executable, checker, folder], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def test_the_checker_passes_pages_whose_links_lead_somewhere(tmp_path: Path) -> None:
    (tmp_path / "a b.html").write_text('<p id="here"></p><a href="#here"></a><a href="https://nowhere.example/x"></a>')
    (tmp_path / "c.html").write_text('<a href="a%20b.html#here"></a><a href="a%20b.html"></a>')
    assert checked(tmp_path) == (0, "0 broken links\n")


@pytest.mark.parametrize("link", ["d.html", "a.html#there", "#there", "d.png"])
def test_the_checker_names_a_link_that_leads_nowhere(tmp_path: Path, link: str) -> None:
    (tmp_path / "a.html").write_text('<p id="here"></p>')
    (tmp_path / "c.html").write_text(f'<p></p>\n<a href="{link}"></a>')
    status, said = checked(tmp_path)
    assert status == 1
    assert f"c.html:2: {link}: " in said
    assert said.endswith("1 broken links\n")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_experiment_that_a_page_names_is_there(page: Path) -> None:
    named = set(re.findall(r"\bexperiments\.[a-z_.]+[a-z_]", page.read_text()))
    paths = {name: REPOSITORY / name.replace(".", "/") for name in named}
    assert [
        n for n, path in paths.items() if not (path.with_suffix(".py").exists() or (path / "__main__.py").exists())
    ] == []


def test_the_readme_is_short() -> None:
    assert len((REPOSITORY / "README.md").read_text().split()) <= WORDS_OF_README


def test_every_public_name_is_on_a_page_of_the_api() -> None:
    documented = set(
        re.findall(r":: synchronizar\.(?:_core\.)?(\w+)$", (DOCS / "api.md").read_text(), flags=re.MULTILINE)
    )
    assert ":: synchronizar.parameters\n" in (DOCS / "parameters.md").read_text()
    for client in ("client.Client", "blocking.BlockingClient"):
        assert f":: synchronizar.live.{client}\n" in (DOCS / "api.md").read_text()
    assert set(synchronizar.__all__) - documented == {"Parameters", "live"}


def keys(of: Any) -> set[str]:
    """All keys in a JSON value, but for those of `users`, which are names."""
    if isinstance(of, dict):
        named = [list(value.values()) if key == "users" else value for key, value in of.items()]
        return set(of).union(*map(keys, named))
    return set().union(*map(keys, of)) if isinstance(of, list) else set()


def test_keys_are_found_at_any_depth_and_names_are_none() -> None:
    assert keys({"a": 1, "users": {"bob": {"b": [{"c": {}}], "d": "e"}}}) == {"a", "users", "b", "c", "d"}


def explained(page: str) -> set[str]:
    """All words in backticks of a page."""
    return set(re.findall(r"`([\w-]+)`", (DOCS / page).read_text()))


@pytest.fixture(scope="module")
def answers(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short walk beside a radio, registered into `answer` and replayed into `live`."""
    folder = tmp_path_factory.mktemp("answers")
    walk = str(folder / "walk")
    options = ["--seconds", "6", "--static-radios", "1", "--jumps", "1", "--seed", "2"]
    assert main(["simulate", walk, *options]) == 0
    assert main(["register", walk, "--out", str(folder / "answer")]) == 0
    assert main(["replay", walk, "--out", str(folder / "live")]) == 0
    return folder


def test_every_key_of_registration_json_is_explained(answers: Path) -> None:
    assert keys(json.loads((answers / "answer" / "registration.json").read_text())) - explained("answer.md") == set()


def test_every_key_of_updates_jsonl_is_explained(answers: Path) -> None:
    last = (answers / "live" / "updates.jsonl").read_text().splitlines()[-1]
    assert keys(json.loads(last)) - explained("answer.md") == set()


def test_every_code_of_a_finding_is_explained() -> None:
    from synchronizar.data.findings import Code

    table = (DOCS / "answer.md").read_text().split("| code | what looks wrong |")[1].split("\n\n")[0]
    assert re.findall(r"^\| `([\w-]+)` \|", table, flags=re.MULTILINE) == list(Code)


def test_every_column_of_ranges_csv_is_explained(answers: Path) -> None:
    header = (answers / "answer" / "ranges.csv").read_text().splitlines()[0]
    assert set(header.split(",")) - explained("answer.md") == set()


def test_every_key_of_an_evaluation_is_explained(answers: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["evaluate", str(answers / "walk"), str(answers / "answer"), "--json"]) == 0
    assert set(json.loads(capsys.readouterr().out)) - explained("commands.md") == set()


def test_every_key_of_a_check_is_explained(answers: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    main(["check", str(answers / "walk"), "--json"])
    assert keys(json.loads(capsys.readouterr().out)) - explained("commands.md") - explained("answer.md") == set()


def commands_of(page: Path) -> set[str]:
    """The commands that a table of a page has a row of."""
    return set(re.findall(r"^\| `synchronizar (\w+)", page.read_text(), flags=re.MULTILINE))


def test_every_command_has_a_row_and_no_other_does(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--help"])
    offered = set(re.findall(r"^ {4}(\w+) ", capsys.readouterr().out, flags=re.MULTILINE))
    assert "register" in offered
    assert commands_of(DOCS / "commands.md") == offered
    assert commands_of(REPOSITORY / "README.md") <= offered


def test_every_column_of_a_recording_is_explained() -> None:
    from synchronizar.io.ranges_csv import OPTIONAL, REQUIRED

    assert {*REQUIRED, *OPTIONAL} - explained("data.md") == set()


def blocks(page: Path, language: str) -> list[str]:
    """The code of a page in one language."""
    return [str(code) for code in re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_every_python_block_of_a_page_compiles(page: Path) -> None:
    for code in blocks(page, "python"):
        compile(code, str(page), "exec")


def test_every_setting_that_is_shown_is_read_as_it_stands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from synchronizar.io.recording_toml import read_recording_toml

    shown = blocks(DOCS / "data.md", "toml")
    assert len(shown) == 3
    for text in shown:
        (tmp_path / "recording.toml").write_text(text)
        read_recording_toml(tmp_path / "recording.toml")
    assert capsys.readouterr().err == ""


def test_the_settings_that_are_explained_are_those_of_a_user(tmp_path: Path) -> None:
    from synchronizar.io.recording_toml import read_recording_toml

    table = (DOCS / "data.md").read_text().split("| setting | unit | meaning |")[1].split("\n\n")[0]
    values = {"up": '"y"', "static": "true", "height_sigma": "1", "position": "[0, 0, 0]", "position_sigma": "1"}
    values |= {"range_bias": "0", "range_bias_sigma": "1", "antennas.NAME": "[0, 0, 0]"}
    beside = {"position": "static = true\n", "position_sigma": "static = true\nposition = [0, 0, 0]\n"}
    assert set(re.findall(r"^\| `([\w.]+)`", table, flags=re.MULTILINE)) == set(values)
    for setting, value in values.items():
        (tmp_path / "recording.toml").write_text(f"[users.bob]\n{beside.get(setting, '')}{setting} = {value}\n")
        read_recording_toml(tmp_path / "recording.toml")
