from __future__ import annotations

import json
import re
import subprocess
import sys

from support.paths import REPOSITORY

VENDOR = REPOSITORY / "synchronizar" / "live" / "pages" / "vendor"


def test_third_party_modules_are_the_pinned_ones() -> None:
    run = subprocess.run(
        [sys.executable, REPOSITORY / "tools" / "vendor.py"], capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr


def test_each_has_its_licence_and_imports_nothing_that_is_not_there() -> None:
    for name in json.loads((VENDOR / "vendor.json").read_text()):
        assert "Permission is hereby granted" in (VENDOR / name / "LICENSE").read_text()
        for module in (VENDOR / name).glob("*.js"):
            for imported in re.findall(r"\bfrom\s*[\"']([^\"']+)[\"']", module.read_text()):
                assert (module.parent / imported).is_file()
