"""Scenes done in parallel, kept as soon as they are done, not done again."""

from __future__ import annotations

import hashlib
import multiprocessing
import sys
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

from experiments.integrity.families import FAMILIES
from experiments.integrity.judging import Judged, Task, judge, judged_of, line_of

ROOT = Path(__file__).parents[2]
OF_THE_STUDY = ("trial", "faults", "families", "scoring", "best", "judging")
SOURCES = (
    "synchronizar/**/*.py",
    "factors/*",
    "bindings/*",
    "experiments/common/*.py",
    "experiments/accuracy/full_walks.py",
    "experiments/accuracy/late_kinds.py",
    *(f"experiments/integrity/{name}.py" for name in OF_THE_STUDY),
)


@cache
def version() -> str:
    """Of all that a result hangs on: the estimator's sources and the study's."""
    digest = hashlib.sha256()
    for file in sorted({file for pattern in SOURCES for file in ROOT.glob(pattern) if file.is_file()}):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]


def all_of(
    asked: Sequence[Task], file: Path, minutes: float, processes: int | None = None, scheduler: str | None = None
) -> list[Judged]:
    """The scenes that were asked for, done now or before; no further one is begun after so many minutes."""
    from tqdm import tqdm

    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    known = {(s.family, s.seed): s for s in map(judged_of, lines) if s.version == version()}
    left = [task for task in asked if task not in known]
    file.parent.mkdir(exist_ok=True, parents=True)
    until = time.time() + 60.0 * minutes
    with (
        file.open("a", encoding="utf-8") as out,
        tqdm(total=len(left), disable=not sys.stderr.isatty(), leave=False) as bar,
    ):
        for done in _done(left, until, processes, scheduler):
            if done is not None:
                known[done.family, done.seed] = done
                out.write(line_of(done))
                out.flush()
            bar.update()
    return sorted((known[task] for task in asked if task in known), key=_place)


def _place(scene: Judged) -> tuple[int, int]:
    return FAMILIES.index(scene.family), scene.seed


class _InTime:
    """Judges a scene unless time is over."""

    def __init__(self, until: float, of: str) -> None:
        self.until, self.of = until, of

    def __call__(self, task: Task) -> Judged | None:
        return judge(task, self.of) if time.time() < self.until else None


def _done(left: Sequence[Task], until: float, processes: int | None, scheduler: str | None) -> Iterator[Judged | None]:
    """Results as they come, None of those for which there was no time."""
    work = _InTime(until, version())
    if scheduler is not None:
        from distributed import Client, as_completed

        with Client(scheduler) as client:  # type: ignore[no-untyped-call]
            futures = client.map(work, left, pure=False)
            for future in as_completed(futures):  # type: ignore[no-untyped-call]
                yield future.result()
        return
    with multiprocessing.Pool(processes) as pool:
        yield from pool.imap_unordered(work, left)
