from __future__ import annotations

import subprocess
import sys

from support.paths import REPOSITORY


def test_the_protocols_page_is_what_the_messages_say() -> None:
    command = [sys.executable, "tools/protocol_page.py", "--check"]
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
