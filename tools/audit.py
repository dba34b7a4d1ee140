"""Known vulnerabilities of everything that is installed in an environment: `audit.py .venv`.

Asks PyPI by pip-audit, which gets an environment of its own, so that it is not among what it looks at. Where nobody can
be asked nothing is known: that is said, and is no failure.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import venv
from pathlib import Path
from urllib.error import URLError
from urllib.request import urlopen

ASKED = "https://pypi.org/pypi/pip/json"
WITHIN_S = 10.0
PIP_AUDIT = "pip-audit>=2.9,<3"


def reachable(address: str, within_s: float = WITHIN_S) -> bool:
    """Whether somebody answers there."""
    try:
        with urlopen(address, timeout=within_s) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False


def audit(environment: Path, tool: Path, asked: str = ASKED) -> int:
    """0 where nothing is known against any package, or nobody can be asked."""
    if not reachable(asked):
        print("skipped: pypi.org cannot be reached, so nothing is known of vulnerabilities")
        return 0
    if not (tool / "bin" / "pip-audit").exists():
        venv.create(tool, with_pip=True)
        subprocess.run([tool / "bin" / "python", "-m", "pip", "install", "--quiet", PIP_AUDIT], check=True)
    (packages,) = environment.glob("lib/python*/site-packages")
    looks = [tool / "bin" / "pip-audit", "--progress-spinner", "off", "--skip-editable", "--path", packages]
    return subprocess.run(looks, check=False).returncode


def main() -> int:
    """Of the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("environment", type=Path)
    parser.add_argument("--tool", type=Path, default=Path("build/audit"), help="where pip-audit is installed")
    arguments = parser.parse_args()
    return audit(arguments.environment, arguments.tool)


if __name__ == "__main__":
    sys.exit(main())
