"""How often a user called `registered` is off, and how often one who could be placed is not called so.

`python -m experiments.integrity [--seeds build|judge] [--scenes 1000] [--minutes 30] [--scheduler ADDRESS]` draws
scenes of every family in turn, solves each at once (`register`) and as it would have come (`replay`), and compares
with the truth: a placement is wrong that is off by more than 0.6 m anywhere on the user's walk, or by more than 0.5 rad
in heading, in the axes of the reference's device. At once there is one verdict on each user; while people walk, an
episode is a stretch of updates in which a user is called registered, and is wrong where it is so at any moment.

`judge` seeds are for the last word: nothing is built with them. Each scene that is done goes to FILE.jsonl at once, and
is not done again by the same estimator and study; the report is of all that the file has of these. `--scene FAMILY
SEED` solves one scene again and tells everything, and with `--save FOLDER` writes it as a recording with its truth.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from experiments.common.results import FOLDER
from experiments.integrity.families import BASES, FAMILIES, drawn, tasks
from experiments.integrity.judging import Judged, judge
from experiments.integrity.report import written
from experiments.integrity.running import all_of, version


def main() -> None:
    """The report, or one scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", choices=list(BASES), default="build")
    parser.add_argument("--scenes", type=int, default=1000)
    parser.add_argument("--first", type=int, default=0, help="of the scenes of these seeds")
    parser.add_argument("--families", nargs="+", choices=FAMILIES, default=list(FAMILIES), metavar="FAMILY")
    parser.add_argument("--minutes", type=float, default=30.0, help="after which no further scene is begun")
    parser.add_argument("--processes", type=int)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a Dask cluster that does the scenes")
    parser.add_argument("--out", type=Path, metavar="FILE", help="without a suffix")
    parser.add_argument("--scene", nargs=2, metavar=("FAMILY", "SEED"))
    parser.add_argument("--save", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    if options.scene is not None:
        one(options.scene[0], int(options.scene[1]), options.save)
        return
    file = options.out or FOLDER / f"integrity_{options.seeds}"
    asked = [task for task in tasks(options.seeds, options.scenes, options.first) if task[0] in options.families]
    scenes = all_of(asked, file.with_suffix(".jsonl"), options.minutes, options.processes, options.scheduler)
    if not scenes:
        sys.exit("no scene was done in time")
    settings = {**vars(options), "out": str(file), "save": None, "version": version()}
    print(written(scenes, settings, file), end="")
    print(file.with_suffix(".png"))


def one(family: str, seed: int, folder: Path | None) -> None:
    """Everything about one scene."""
    scene = drawn(family, seed)
    if folder is not None:
        scene.trial.simulation.save(folder)
    print(f"{family} {seed}: {' + '.join(scene.kinds)}")
    print(scene.trial.simulation.scene)
    tell(judge((family, seed)))


def tell(done: Judged) -> None:
    """Every verdict and every episode."""
    for v in done.verdicts:
        off = "no placement" if v.off is None else f"{v.off.place:.2f} m, {v.off.yaw:.2f} rad at {v.off.sigma:.2f} m"
        placed = "" if v.well is None else ", ML places it" if v.well else ", ML does not place it"
        wrong = "WRONG " if v.off is not None and v.off.wrong and v.state == "registered" else ""
        print(f"{wrong}at once {v.user}: {v.state}, {off} (1 sigma); at last while walking {v.live}{placed}")
    for e in done.episodes:
        off = f"{e.off.place:.2f} m, {e.off.yaw:.2f} rad at {e.off.sigma:.2f} m (1 sigma)"
        print(f"{'WRONG ' * e.wrong}{e.begin:.1f} to {e.end:.1f} s {e.user}: {off}, wrong for {e.off_s:.1f} s")
    if done.crashed:
        print(done.crashed)
    print(f"{done.cpu:.1f} s of CPU")


if __name__ == "__main__":
    main()
