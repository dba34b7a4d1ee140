"""Third-party modules that the pages ship: unchanged files of an npm package, with its licence, pinned by their hashes.

    python tools/vendor.py           whether the files are the pinned ones (exit 1: they are not)
    python tools/vendor.py --fetch   get them anew by `npm pack`, and check them

To take another version, change PACKAGES, run `--fetch --pin`, and look at what changed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tarfile
import tempfile
from hashlib import sha256
from pathlib import Path

VENDOR = Path(__file__).parents[1] / "synchronizar" / "live" / "pages" / "vendor"
PINNED = VENDOR / "vendor.json"
"""What is shipped: package, version, licence, and the sha256 of each file."""
# The last version whose package has minified modules; the ones after it are three times as large.
PACKAGES = {"three": ("0.185.0", "MIT", ("build/three.module.min.js", "build/three.core.min.js", "LICENSE"))}


def fetch(name: str, version: str, files: tuple[str, ...]) -> None:
    """Take files out of a package of the npm registry."""
    with tempfile.TemporaryDirectory() as folder:
        run = ["npm", "pack", f"{name}@{version}", "--silent", "--pack-destination", folder]
        subprocess.run(run, check=True, stdout=subprocess.DEVNULL)
        (VENDOR / name).mkdir(parents=True, exist_ok=True)
        with tarfile.open(next(Path(folder).glob("*.tgz"))) as package:
            for file in files:
                content = package.extractfile(f"package/{file}")
                assert content is not None
                (VENDOR / name / Path(file).name).write_bytes(content.read())


def shipped() -> dict[str, object]:
    """What stands in the folder now, as it would be pinned."""
    return {
        name: {
            "version": version,
            "licence": licence,
            "sha256": {f.name: sha256(f.read_bytes()).hexdigest() for f in sorted((VENDOR / name).iterdir())},
        }
        for name, (version, licence, _) in PACKAGES.items()
    }


def main() -> int:
    """Check, and fetch before where asked."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fetch", action="store_true", help="get the files anew from the npm registry")
    parser.add_argument("--pin", action="store_true", help="take what is there as what is meant")
    options = parser.parse_args()
    if options.fetch:
        for name, (version, _, files) in PACKAGES.items():
            fetch(name, version, files)
    if options.pin:
        PINNED.write_text(json.dumps(shipped(), indent=2) + "\n")
    if shipped() != json.loads(PINNED.read_text()):
        print(f"the files in {VENDOR} are not the ones that vendor.json pins", file=sys.stderr)
        return 1
    print(*(f"{name} {version}" for name, (version, _, _) in PACKAGES.items()), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
