from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from support.paths import REPOSITORY


@pytest.mark.parametrize(
    ("said", "status", "expected", "skipped"),
    [
        ("requests.exceptions.ConnectionError: Max retries exceeded", 1, 0, True),
        ("Found 1 known vulnerability in 1 package", 1, 1, False),
        ("usage: pip-audit", 2, 2, False),
        ("No known vulnerabilities found", 0, 0, False),
    ],
)
def test_where_nobody_can_be_asked_of_vulnerabilities_it_is_said(
    said: str, status: int, expected: int, skipped: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = importlib.util.spec_from_file_location("audit", REPOSITORY / "tools" / "audit.py")
    assert spec is not None
    assert spec.loader is not None
    audit = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(audit)
    (tmp_path / "venv" / "lib" / "python3" / "site-packages").mkdir(parents=True)
    tool = tmp_path / "tool" / "bin" / "pip-audit"
    tool.parent.mkdir(parents=True)
    tool.write_text(f"#!/bin/sh\necho '{said}' >&2\nexit {status}\n")
    tool.chmod(0o755)
    assert audit.audit(tmp_path / "venv", tmp_path / "tool") == expected
    assert ("skipped" in capsys.readouterr().out) == skipped


def test_vulnerabilities_are_looked_for_in_ci() -> None:
    assert "make audit" in (REPOSITORY / ".github" / "workflows" / "ci.yml").read_text()
    assert "tools/audit.py" in (REPOSITORY / "Makefile").read_text()
