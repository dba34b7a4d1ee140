from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest
from support.paths import REPOSITORY


def test_where_nobody_can_be_asked_of_vulnerabilities_it_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = importlib.util.spec_from_file_location("audit", REPOSITORY / "tools" / "audit.py")
    assert spec is not None
    assert spec.loader is not None
    audit = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(audit)
    assert audit.audit(tmp_path, tmp_path / "tool", "http://127.0.0.1:9/") == 0
    assert "skipped" in capsys.readouterr().out
    assert not (tmp_path / "tool").exists()


def test_vulnerabilities_are_looked_for_in_ci() -> None:
    assert "make audit" in (REPOSITORY / ".github" / "workflows" / "ci.yml").read_text()
    assert "tools/audit.py" in (REPOSITORY / "Makefile").read_text()
