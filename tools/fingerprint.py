"""Digests of everything that register and replay write, timings apart: equal digests, equal bytes.

    python fingerprint.py RECORDINGS [--scenes N] > digests.txt

For each recording in the folder RECORDINGS, and for seeded scenes, a line a file: its SHA-256, and what it is of.
Uses the command line alone, so that any two commits can be compared.
"""

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

SCENES = {
    "clean": [],
    "four": ["--users", "4", "--late-share", "0.3", "--seed", "7"],
    "wrong": [
        "--users",
        "3",
        "--seconds",
        "40",
        "--scale-sigma",
        "0.1",
        "--clock-offset-sigma",
        "0.1",
        "--bias-sigma",
        "0.1",
        "--jumps",
        "1",
        "--late-share",
        "0.2",
        "--drift-m-per-sqrt-s",
        "0.02",
        "--drift-rad-per-sqrt-s",
        "0.01",
        "--seed",
        "3",
        "--power",
    ],
    "radios": [
        "--users",
        "2",
        "--static-radios",
        "3",
        "--late-joiners",
        "1",
        "--seconds",
        "30",
        "--seed",
        "5",
        "--antennas",
        "2",
        "--up",
        "y",
    ],
    "line": ["--users", "3", "--walk", "line", "--seed", "2"],
    "long": [
        "--users",
        "2",
        "--seconds",
        "300",
        "--seed",
        "1",
        "--drift-m-per-sqrt-s",
        "0.01",
        "--drift-rad-per-sqrt-s",
        "0.005",
    ],
}
METHODS = {
    "full": ["register"],
    "rigid": ["register", "--model", "rigid"],
    "pairwise": ["register", "--method", "pairwise"],
    "replay": ["replay"],
}


def without_timings(file: Path) -> bytes:
    """The file's bytes, less what a clock has measured."""
    if file.name == "registration.json":
        told = json.loads(file.read_bytes())
        told.pop("seconds")
        return json.dumps(told).encode()
    if file.name == "updates.jsonl":
        lines = [json.loads(line) for line in file.read_text().splitlines()]
        for line in lines:
            line.pop("update_ms")
        return "\n".join(map(json.dumps, lines)).encode()
    return file.read_bytes()


def beginning(recording: Path, folder: Path, seconds: float) -> Path:
    """A copy of a recording's first seconds, by the ranges' clock and by each track's own."""
    shutil.copytree(recording, folder)
    for file in [folder / "ranges.csv", *(folder / "tracks").glob("*.tum")]:
        lines = [line for line in file.read_text().splitlines(keepends=True) if line.strip()]
        rows = [n for n, line in enumerate(lines) if line[0] in "-.0123456789"]
        times = [float(lines[n].replace(",", " ").split()[0]) for n in rows]
        late = {n for n, t in zip(rows, times, strict=True) if t > min(times) + seconds}
        file.write_text("".join(line for n, line in enumerate(lines) if n not in late))
    return folder


def run(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "synchronizar", *arguments], check=True, stdout=subprocess.DEVNULL)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recordings", type=Path)
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        sources = {}
        for name, scene in SCENES.items():
            if not options.only or name in options.only.split(","):
                sources[name] = Path(scratch, "scenes", name)
                sources[name].parent.mkdir(exist_ok=True)
                run("simulate", str(sources[name]), *scene)
        for folder in sorted(options.recordings.iterdir()):
            if folder.is_dir() and (not options.only or folder.name in options.only.split(",")):
                sources[folder.name] = folder
        for name, source in sources.items():
            for method in options.methods.split(","):
                out = Path(scratch, "out", f"{name}-{method}")
                out.parent.mkdir(exist_ok=True)
                walk = source
                if method == "replay":
                    few = (
                        len(
                            {
                                line.split(",")[k]
                                for line in (source / "ranges.csv").read_text().splitlines()
                                for k in (1, 2)
                            }
                        )
                        <= 6
                    )
                    walk = beginning(source, Path(scratch, "cut", name), 30.0 if few else 5.0)
                run(METHODS[method][0], str(walk), *METHODS[method][1:], "--out", str(out))
                for file in sorted(out.iterdir()):
                    digest = hashlib.sha256(without_timings(file)).hexdigest()
                    print(digest, f"{name} {method} {file.name}", flush=True)


if __name__ == "__main__":
    main()
