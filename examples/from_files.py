"""A recording as a logger writes it, loaded and solved; every file of it is made here.

`python examples/from_files.py [RECORDING]` solves a recording of your own instead.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import synchronizar as sz


def main() -> None:
    """Write a recording unless one is given, solve it, and read the answer."""
    if len(sys.argv) > 1:
        solve(Path(sys.argv[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        truth = write_recording(Path(folder))
        track = solve(Path(folder))["bob"]
    # Alice's own first pose fixes the common frame, so that the truth in her frame is the truth in it.
    print(f"error: {np.linalg.norm(track.position - truth, axis=1).max():.3f} m")


def solve(folder: Path) -> dict[str, sz.Track]:
    """The track of every user in the common frame."""
    recording = sz.Recording.load(folder)
    registration = sz.register(recording)
    print(f"in the frame of {registration.reference}:")
    for name, user in registration.users.items():
        print(f"{name}: {user.state}: {user.reason}")
        if user.common_from_user is not None:
            print(np.array_str(user.common_from_user.matrix, precision=3, suppress_small=True))
    return registration.tracks(recording)


def write_recording(folder: Path) -> np.ndarray:
    """Write tracks/alice.tum, tracks/bob.tum, ranges.csv and recording.toml; returns Bob's places in Alice's frame."""
    t = 1.7e9 + np.arange(0.0, 15.0, 0.1)  # s since 1970
    s = t - t[0]
    alice = np.column_stack([2.0 * np.sin(0.5 * s), 2.0 * np.sin(0.8 * s), 0.05 * np.sin(9.0 * s)])
    bob = np.column_stack([3.0 * np.cos(0.4 * s), 2.0 * np.sin(0.6 * s), 0.05 * np.cos(8.0 * s)])
    bob_own = (bob - [3.0, 1.0, 0.0])[:, [1, 0, 2]] * [1.0, -1.0, 1.0]  # his frame lies there, turned by 90 degrees
    (folder / "tracks").mkdir()
    for name, position in (("alice", alice), ("bob", bob_own)):
        with (folder / "tracks" / f"{name}.tum").open("w") as file:
            for when, (x, y, z) in zip(t, position, strict=True):
                file.write(f"{when:.3f} {x:.6f} {y:.6f} {z:.6f} 0 0 0 1\n")
    measured = np.linalg.norm(alice - bob, axis=1) + np.random.default_rng(2).normal(0.0, 0.1, len(t))
    with (folder / "ranges.csv").open("w") as file:
        file.write("t,a,b,range,sigma\n")
        for when, distance in zip(t, measured, strict=True):
            file.write(f"{when:.3f},alice,bob,{distance:.4f},0.1\n")
    (folder / "recording.toml").write_text('up = "z"\n')
    return bob


if __name__ == "__main__":
    main()
