"""Searches run beside the engine, in a process of their own, or at once where there is none."""

from __future__ import annotations

from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

from synchronizar.estimation.incremental.search import search
from synchronizar.estimation.incremental.snapshot import Found, Snapshot


class Searcher:
    """One search at a time; `poll` gives what it found."""

    def __init__(self, workers: int) -> None:
        """`workers`: 1, a process of its own; 0, none: `begin` searches at once, and all is deterministic."""
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None
        self._running: Future[Found | None] | None = None
        self._purpose = ""

    @property
    def busy(self) -> bool:
        """Whether a search is going on, or one's findings were not taken yet."""
        return self._running is not None

    def begin(self, snapshot: Snapshot) -> None:
        """Search; there must be no other search."""
        if not self.workers:
            self._running = Future()
            self._running.set_result(search(snapshot))
            return
        if self._pool is not None:
            try:
                self._running = self._pool.submit(search, snapshot)
                return
            except BrokenProcessPool:  # killed while it had nothing to do
                self._pool = None
        # Not forked: the caller may have threads, and locks that they hold.
        self._pool = ProcessPoolExecutor(1, get_context("spawn"))
        self._running = self._pool.submit(search, snapshot)

    def poll(self) -> tuple[bool, Found | None]:
        """Whether a search has ended, and what it found; None where it found nothing or its process died."""
        running = self._running
        if running is None or not running.done():
            return False, None
        self._running = None
        try:
            return True, running.result()
        except BrokenProcessPool:  # killed from outside, or out of memory: the next search gets a new one
            self._pool = None
            return True, None

    def abandon(self) -> None:
        """What it finds is not wanted any more."""
        self._running = None

    def close(self) -> None:
        """End its process."""
        if self._pool is not None:
            self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool, self._running = None, None
