"""Searches run beside the engine, in a process of their own, or at once where there is none."""

from __future__ import annotations

import pickle
import subprocess
import sys
from concurrent.futures import Future
from threading import Thread

from synchronizar.estimation.incremental.search import search
from synchronizar.estimation.incremental.snapshot import Found, Snapshot


class Searcher:
    """One search at a time; `poll` gives what it found."""

    def __init__(self, workers: int) -> None:
        """`workers`: 1, a process of its own; 0, none: `begin` searches at once, and all is deterministic."""
        self.workers = workers
        self._process: subprocess.Popen[bytes] | None = None
        self._running: Future[Found | None] | None = None

    @property
    def busy(self) -> bool:
        """Whether a search is going on, or one's findings were not taken yet."""
        return self._running is not None

    def begin(self, snapshot: Snapshot) -> None:
        """Search; there must be no other search."""
        self._running = Future()
        if not self.workers:
            self._running.set_result(search(snapshot))
            return
        if self._process is None or self._process.poll() is not None:
            # Its own program: multiprocessing would fork its caller's locks, or run its caller's script again.
            command = [sys.executable, "-m", "synchronizar.estimation.incremental.worker"]
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        Thread(target=_exchange, args=(self._process, snapshot, self._running), daemon=True).start()

    def poll(self) -> tuple[bool, Found | None]:
        """Whether a search has ended, and what it found; None where it found nothing or its process died."""
        running = self._running
        if running is None or not running.done():
            return False, None
        self._running = None
        if running.exception() is not None and self.workers:
            self.close()  # killed from outside, or out of memory: the next search gets a new one
            return True, None
        return True, running.result()

    def abandon(self) -> None:
        """What it finds is not wanted any more."""
        if self._running is not None and not self._running.done():
            self.close()
        self._running = None

    def close(self) -> None:
        """End its process."""
        process, self._process, self._running = self._process, None, None
        if process is not None:
            process.kill()
            process.wait()


def _exchange(process: subprocess.Popen[bytes], snapshot: Snapshot, found: Future[Found | None]) -> None:
    """Give a process a snapshot, and wait for what it finds."""
    assert process.stdin is not None
    assert process.stdout is not None
    try:
        pickle.dump(snapshot, process.stdin)
        process.stdin.flush()
        found.set_result(pickle.load(process.stdout))
    except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
        found.set_exception(error)
