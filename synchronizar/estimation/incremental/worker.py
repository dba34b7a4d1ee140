"""The process that searches: snapshots come on standard input, what was found goes out on standard output."""

from __future__ import annotations

import os
import pickle
import sys

from synchronizar.estimation.incremental.search import search


def serve() -> None:
    """Search until there are no more snapshots."""
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


if __name__ == "__main__":
    serve()
