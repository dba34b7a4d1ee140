"""Known vulnerabilities of everything that is installed in an environment: `audit.py .venv`.

pip-audit asks for them; it gets an environment of its own, so that it is not among what it looks at. Where nobody can
be asked nothing is known: that is said, and is no failure.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import venv
from pathlib import Path

PIP_AUDIT = "pip-audit>=2.9,<3"
UNREACHED = ("ConnectionError", "ConnectTimeout", "Could not connect", "Max retries exceeded", "ReadTimeout")
"""What pip-audit and pip say where nobody answers."""


def audit(environment: Path, tool: Path) -> int:
    """0 where nothing is known against any package, or nobody can be asked; else what pip-audit, or pip, returns."""
    if not (tool / "bin" / "pip-audit").exists():
        venv.create(tool, with_pip=True)
        status = _run([tool / "bin" / "python", "-m", "pip", "install", "--quiet", PIP_AUDIT])
        if status != 0 or not (tool / "bin" / "pip-audit").exists():
            return status
    (packages,) = environment.glob("lib/python*/site-packages")
    return _run([tool / "bin" / "pip-audit", "--progress-spinner", "off", "--skip-editable", "--path", packages])


def _run(command: list[str | Path]) -> int:
    """Its exit status; 0, and a word, where it failed because nobody answered."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    print(done.stdout, end="")
    if done.returncode != 0 and any(words in done.stderr for words in UNREACHED):
        print("skipped: nobody who knows vulnerabilities can be reached, so none are known")
        return 0
    print(done.stderr, end="", file=sys.stderr)
    return done.returncode


def main() -> int:
    """Of the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("environment", type=Path)
    parser.add_argument("--tool", type=Path, default=Path("build/audit"), help="where pip-audit is installed")
    arguments = parser.parse_args()
    return audit(arguments.environment, arguments.tool)


if __name__ == "__main__":
    sys.exit(main())
