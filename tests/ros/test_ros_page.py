from __future__ import annotations

import ast
import json
import re
import tomllib
from pathlib import Path

import pytest
from support.paths import REPOSITORY

from synchronizar.cli.commands import COMMANDS
from synchronizar.cli.parser import parser_of
from synchronizar.convert.asked import Asked
from synchronizar.ros.options import BridgeOptions

PAGE = (REPOSITORY / "docs" / "ros.md").read_text()


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE, flags=re.DOTALL)


def test_the_compose_file_has_commands_that_are_there() -> None:
    yaml = pytest.importorskip("ruamel.yaml")
    (text,) = blocks("yaml")
    services = yaml.YAML(typ="safe").load(text)["services"]
    assert services.keys() == {"room", "rosbridge", "bridge"}
    name, *argv = services["bridge"]["entrypoint"] + services["bridge"]["command"]
    assert name == "synchronizar"
    assert parser_of(COMMANDS).parse_args(argv).bridges == [(None, "ws://127.0.0.1:9090")]
    assert services["room"].items() <= services["bridge"].items()
    file = REPOSITORY / services["room"]["build"]["dockerfile"]
    (kept,) = re.findall(r"^VOLUME (.*)$", file.read_text(), flags=re.MULTILINE)
    assert sorted(json.loads(kept)) == sorted(volume.partition(":")[2] for volume in services["room"]["volumes"])


def test_the_launch_file_is_python_and_its_command_is_there() -> None:
    (text,) = blocks("python")
    tree = ast.parse(text)
    words = [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    assert {"synchronizar", "ros", "--bridge", "ws://127.0.0.1:9090"} <= set(words)


def test_the_map_of_the_page_is_taken(tmp_path: Path) -> None:
    (text,) = blocks("toml")
    written = tmp_path / "map.toml"
    written.write_text(text)
    assert tomllib.loads(text)
    robots = BridgeOptions("http://x/#A", [(None, "ws://a:1")], Asked(map=written)).robots
    assert robots.keys() == {"alice", "anchor1"}
    assert robots["alice"].tf == "/alice/tf"
