"""What is told while something goes wrong: SLAM slides, jumps, sees a lift's cabin, restarts, and so on.

`python -m experiments.live.faults [--kinds ...] [--seeds 4] [--cases ../shared/cases] [--pictures]`: walks of four with
one fault (experiments/common/faults.py) fed to an `Estimator` of one thread. Told of each kind: for how long poses were
written as registered while off by more than 0.6 m (in space, in the common frame), the longest stretch and in all, of
users at fault and of the others; the share of poses from 15 s until the fault that users at fault were registered for;
the share of poses from then on that the others were; and how long after the fault's end the last one is registered and
right again, and stays so for 2 s. `--cases`: the same of recordings with truth, the reference's own track laid onto its
truth; a fault begins where a track is 0.6 m from where its first 15 s say. `--pictures` draws errors and states of each
kind's first seed, and of each case.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from experiments.common.faults import KINDS, REFERENCE, fault_of
from experiments.common.full_oracle import true_tracks
from experiments.common.live import OFF, Call, estimator_of, fed, told, written
from experiments.common.markdown import markdown
from experiments.common.results import FOLDER, write_table
from experiments.common.study import WIDE_INCHES, figure
from experiments.common.walks import on_all_cores
from synchronizar.arrays import Array, Mask
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.reporting.evaluate import MAX_GAP_S, Matched, align, match, read_tracks

SETTLED_S = 15.0
LONGEST_S = 1.0
"""s: nobody should be written as registered and off for longer."""
STAYS_S = 2.0
AGAIN_S = 15.0
"""s: within which everybody should be registered again."""


class Course(NamedTuple):
    """One user's poses beside the truth."""

    name: str
    faulty: bool
    t: Array
    """(n,) s after the first range."""
    registered: Mask
    error: Array
    """(n,) m; NaN where nothing was told or the truth is not known."""


class Judged(NamedTuple):
    """One walk."""

    kind: str
    seed: int
    courses: list[Course]
    begin: float
    """s after the first range; so `end`."""
    end: float

    def of(self, faulty: bool) -> list[Course]:
        """The courses of the users at fault, or of the others."""
        return [c for c in self.courses if c.faulty is faulty]


def off_seconds(t: Array, off: Mask) -> tuple[float, float]:
    """The longest stretch (s) of poses that are off, and all of them; a pose counts until the next, 0.2 s at most."""
    if not off.any():
        return 0.0, 0.0
    lasts = np.minimum(np.diff(t, append=t[-1]), 0.2) * off
    within = np.cumsum(lasts)
    begins = np.where(off & ~np.append(False, off[:-1]), within - lasts, 0.0)
    return float((within - np.maximum.accumulate(begins))[off].max()), float(lasts.sum())


def course_off(course: Course) -> tuple[float, float]:
    """The same of poses that were written as registered."""
    return off_seconds(course.t, course.registered & (course.error > OFF))


def again_after(course: Course, end: float) -> float:
    """Seconds (s) from the end until it is registered and right, and stays so for 2 s; infinite for never."""
    right = course.registered & (course.error <= OFF)
    wrong = np.append(course.t[~right], np.inf)
    until = wrong[np.searchsorted(wrong, course.t)] - course.t
    at = np.flatnonzero((course.t >= end) & right & (until > STAYS_S))
    return float(course.t[at[0]] - end) if len(at) else np.inf


def share(courses: list[Course], begin: float, end: float) -> float:
    """The least share of poses between two times for which one of the users was registered; NaN without any."""
    shares = [c.registered[(c.t >= begin) & (c.t < end)] for c in courses]
    return min((float(s.mean()) for s in shares if len(s)), default=np.nan)


def walk(task: tuple[str, int]) -> Judged:
    """A simulated walk."""
    kind, seed = task
    fault = fault_of(kind, seed)
    recording = fault.simulation.recording
    truth = {name: t.position for name, t in true_tracks(fault.simulation, REFERENCE).items()}
    start = float(recording.ranges.t.min())
    courses = _courses(recording, truth, REFERENCE, fault.faulty, fault.arrivals, fault.calls)
    return Judged(kind, seed, courses, fault.begin - start, fault.end - start)


def _courses(
    recording: Recording,
    truth: Mapping[str, Array],
    reference: str,
    faulty: tuple[str, ...],
    arrivals: Mapping[str, Array] | None = None,
    calls: Sequence[tuple[float, Call]] = (),
) -> list[Course]:
    """Feed a recording; `truth` (n, 3) of each track in the common frame, NaN where it is not known."""
    estimator = estimator_of(recording, reference)
    moments = fed(recording, estimator, arrivals=arrivals, calls=calls)
    of = told(recording, moments, estimator)
    out = []
    for name in recording.tracks:
        poses = written(of, recording.tracks[name], name, (arrivals or {}).get(name))
        error = np.linalg.norm(poses.position - truth[name], axis=1)
        t = poses.t - float(recording.ranges.t.min())
        out.append(Course(name, name in faulty, t, poses.registered, error))
    return out


def case(folder: Path) -> Judged | None:
    """A recording with truth; None where its truth and its tracks have no time in common, or not its reference's."""
    recording, truth = Recording.load(folder), read_tracks(folder / "truth")
    reference = min(name for name, track in recording.tracks.items() if track.extent() > OFF)
    laid = match(recording.tracks[reference], truth[reference])
    if laid is None or recording.tracks[reference].t[-1] < recording.ranges.t.min():
        return None
    to_common = align([laid]).inverse()
    start = float(recording.ranges.t.min())
    places, begins = {}, {}
    for name, own in recording.tracks.items():
        true = truth[name].at(own.t, MAX_GAP_S)
        places[name] = np.where(true.valid[:, None], to_common @ true.position, np.nan)
        begins[name] = astray_from(own, places[name]) - start
    faulty = tuple(name for name, at in begins.items() if np.isfinite(at))
    begin = min((begins[name] for name in faulty), default=SETTLED_S)
    return Judged(folder.name, 0, _courses(recording, places, reference, faulty), begin, begin)


def astray_from(own: Track, true: Array) -> float:
    """When (s) a track is first off from where its first 15 s say that it should be; infinite for never."""
    known = np.isfinite(true[:, 0])
    early = known & (own.t < np.median(own.t[:2]) + SETTLED_S)
    if early.sum() < 2:
        return np.inf
    laid = align([Matched(own.position[early], true[early])])
    off = known & (np.linalg.norm(laid @ own.position - true, axis=1) > OFF)
    return float(own.t[np.flatnonzero(off)[0]]) if off.any() else np.inf


def one(task: tuple[str, int] | Path) -> Judged | None:
    """A simulated walk or a case."""
    return case(task) if isinstance(task, Path) else walk(task)


def _line(judged: Judged) -> str:
    """How long each was written as registered and off."""
    off = ", ".join(f"{c.name}{' (at fault)' * c.faulty} {course_off(c)[1]:.1f} s" for c in judged.courses)
    return f"{judged.kind}, seed {judged.seed}: registered and off: {off}"


def row_of(kind: str, walks: list[Judged]) -> dict[str, Any]:
    """A line of the table."""
    row: dict[str, Any] = {"kind": kind, "n": len(walks)}
    for who, faulty in (("at fault", True), ("others", False)):
        off = np.array([course_off(c) for w in walks for c in w.of(faulty)] or [(np.nan, np.nan)])
        row[f"{who}: longest s off"], row[f"{who}: s off in all"] = float(off[:, 0].max()), float(off[:, 1].sum())
    worst = [max((course_off(c)[0] for c in w.courses), default=0.0) for w in walks]
    row["walks with > 1 s"] = sum(s > LONGEST_S for s in worst)
    before = [share(w.of(True), SETTLED_S, w.begin) for w in walks]
    others = [share(w.of(False), w.begin, np.inf) for w in walks]
    row["registered before"], row["others registered then"] = float(np.min(before)), float(np.min(others))
    again = np.array([max((again_after(c, w.end) for c in w.of(True)), default=0.0) for w in walks])
    row["median s until again"], row["at most"] = float(np.median(again)), float(again.max())
    row[f"again by {AGAIN_S:.0f} s"] = float((again <= AGAIN_S).mean())
    return row


def draw(judged: Judged, file: Path) -> None:
    """Errors over time; where a user is called registered its line is thick, where it is so and off, red."""
    made, axes = figure(rows=len(judged.courses), height=1.2)
    for ax, c in zip(axes[:, 0], judged.courses, strict=True):
        shown = np.maximum(c.error, 0.01)
        ax.semilogy(c.t, shown, color="#999999", linewidth=0.6)
        for which, colour in ((c.registered, "#332288"), (c.registered & (c.error > OFF), "#CC3311")):
            ax.semilogy(c.t, np.where(which, shown, np.nan), color=colour, linewidth=1.8)
        ax.axhline(OFF, color="#CC3311", linewidth=0.5)
        ax.axvspan(judged.begin, max(judged.end, judged.begin + 0.1), color="#EE7733", alpha=0.2, linewidth=0.0)
        ax.set(ylabel="error (m)", title=f"{c.name}{', at fault' if c.faulty else ''}")
    axes[-1, 0].set(xlabel="time since the first range (s); thick: registered, red: and off; shaded: the fault")
    made.set_size_inches(WIDE_INCHES, 1.4 * len(judged.courses))
    FOLDER.mkdir(exist_ok=True)
    made.savefig(file, dpi=150)
    print(file)


def main() -> None:
    """The tables and the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="*", choices=list(KINDS), default=list(KINDS))
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cases", type=Path)
    parser.add_argument("--pictures", action="store_true")
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    folders = sorted(f.parent for f in options.cases.glob("*/truth")) if options.cases is not None else []
    groups: dict[str, list[Judged]] = {}
    tasks = [*((kind, seed) for kind in options.kinds for seed in seeds), *folders]
    for task, judged in zip(tasks, on_all_cores(one, tasks, 1), strict=True):
        if judged is not None:
            groups.setdefault(judged.kind, []).append(judged)
            print(_line(judged), flush=True)
            if isinstance(task, tuple) and task[1] == seeds[-1]:
                print(markdown([row_of(judged.kind, groups[judged.kind])], digits=2), flush=True)
    rows = [row_of(kind, of) for kind, of in groups.items()]
    write_table("faults", rows, {**vars(options), "cases": str(options.cases)})
    print(markdown(rows, digits=2))
    if options.pictures:
        for kind, of in groups.items():
            draw(of[0], FOLDER / f"faults_{kind.replace(', ', '_').replace(' ', '_')}.png")


if __name__ == "__main__":
    main()
