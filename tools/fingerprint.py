"""Digests of everything that register and replay write, timings apart: equal digests, equal bytes.

    python tools/fingerprint.py RECORDINGS [--only NAME,NAME] [--methods full,replay] > digests.txt

For each recording in the folder RECORDINGS, and for seeded scenes, a line a file: its SHA-256 and what it is of. Uses
the command line of the environment it runs in alone, so that any two commits can be compared. Replays are of the first
30 s, 5 s where there are more than six users.
"""

import argparse
import csv
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

_DRIFT = "--drift-m-per-sqrt-s 0.02 --drift-rad-per-sqrt-s 0.01"
SCENES = {
    "clean": "",
    "four": "--users 4 --late-share 0.3 --seed 7",
    "wrong": "--users 3 --seconds 40 --scale-sigma 0.1 --clock-offset-sigma 0.1 --bias-sigma 0.1 --jumps 1 "
    f"--late-share 0.2 {_DRIFT} --seed 3 --power",
    "radios": "--users 2 --static-radios 3 --late-joiners 1 --seconds 30 --seed 5 --antennas 2 --up y",
    "line": "--users 3 --walk line --seed 2",
    "long": "--users 2 --seconds 300 --seed 1 --drift-m-per-sqrt-s 0.01 --drift-rad-per-sqrt-s 0.005",
}
METHODS = {
    "full": ["register"],
    "rigid": ["register", "--model", "rigid"],
    "pairwise": ["register", "--method", "pairwise"],
    "replay": ["replay"],
}
_LIVELY = 6  # users: replays of more are cut shorter


def without_timings(file: Path) -> bytes:
    """The file's bytes, less what a clock has measured."""
    if file.name == "registration.json":
        registration = json.loads(file.read_bytes())
        registration.pop("seconds")
        return json.dumps(registration).encode()
    if file.name == "updates.jsonl":
        updates = [json.loads(line) for line in file.read_text(encoding="utf-8").splitlines()]
        for update in updates:
            update.pop("update_ms")
        return "\n".join(map(json.dumps, updates)).encode()
    return file.read_bytes()


def beginning(recording: Path, folder: Path) -> Path:
    """A copy of a recording's first seconds, by the ranges' clock and by each track's own."""
    shutil.copytree(recording, folder)
    with (folder / "ranges.csv").open() as file:
        users = {name for row in csv.DictReader(file) for name in (row["a"], row["b"])}
    seconds = 30.0 if len(users) <= _LIVELY else 5.0
    for file in [folder / "ranges.csv", *(folder / "tracks").glob("*.tum")]:
        lines = [line for line in file.read_text(encoding="utf-8").splitlines(keepends=True) if line.strip()]
        rows = [n for n, line in enumerate(lines) if line[0] in "-.0123456789"]
        times = [float(lines[n].replace(",", " ").split()[0]) for n in rows]
        later = {n for n, t in zip(rows, times, strict=True) if t > min(times) + seconds}
        file.write_text("".join(line for n, line in enumerate(lines) if n not in later))
    return folder


def run(*arguments: str) -> None:
    """A command of the package, its standard output left out."""
    subprocess.run([sys.executable, "-m", "synchronizar", *arguments], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    """Print the digests."""
    parser = argparse.ArgumentParser(description="Digests of everything that register and replay write.")
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    wanted = set(filter(None, options.only.split(",")))
    with tempfile.TemporaryDirectory() as scratch:
        sources = {folder.name: folder for folder in sorted(options.recordings.iterdir()) if folder.is_dir()}
        for name, scene in SCENES.items():
            sources[name] = Path(scratch, "scenes", name)
            sources[name].parent.mkdir(exist_ok=True)
            run("simulate", str(sources[name]), *scene.split())
        for name in sorted(sources.keys() & wanted if wanted else sources):
            for method in options.methods.split(","):
                out = Path(scratch, "out", f"{name}-{method}")
                out.parent.mkdir(exist_ok=True)
                source = beginning(sources[name], Path(scratch, "cut", name)) if method == "replay" else sources[name]
                run(METHODS[method][0], str(source), *METHODS[method][1:], "--out", str(out))
                for file in sorted(out.iterdir()):
                    print(hashlib.sha256(without_timings(file)).hexdigest(), name, method, file.name, flush=True)


if __name__ == "__main__":
    main()
