"""The process that searches: snapshots come on standard input, what was found goes out on standard output."""

from __future__ import annotations

import os
import pickle
import sys
import time
from threading import Thread

from synchronizar.estimation.incremental.search import search

_NICE = 5
"""Whoever waits for updates comes first where all cores are busy."""


def serve() -> None:
    """Search until there are no more snapshots, or whoever asks has ended."""
    Thread(target=_end_after, args=(os.getppid(),), daemon=True).start()
    if hasattr(os, "nice"):  # Windows has none
        os.nice(_NICE)
    snapshots, answers = sys.stdin.buffer, sys.stdout.buffer
    sys.stdout = sys.stderr  # whatever else is printed must not come among the answers
    while True:
        try:
            snapshot = pickle.load(snapshots)
        except EOFError:
            return
        try:
            pickle.dump(search(snapshot), answers)
            answers.flush()
        except BrokenPipeError:
            # Whoever asked has ended; what is left in the buffer must not be tried again at exit.
            os.dup2(os.open(os.devnull, os.O_WRONLY), answers.fileno())
            return


def _end_after(parent: int) -> None:
    """A search may take long, and nobody would want what it finds."""
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(0)


if __name__ == "__main__":
    serve()
