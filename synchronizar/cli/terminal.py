"""What is printed: results on standard output; progress on standard error, and only to a terminal."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from synchronizar.errors import InputError

if TYPE_CHECKING:
    from synchronizar.data.updates import Update
    from synchronizar.progress import Progress

_WIDEST = 80  # columns of what is drawn on a terminal


def print_result(text: str) -> None:
    """Print to standard output, whatever its encoding; a fault is an InputError now and not when Python ends."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except OSError as error:
        # What is left in the buffer would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError("standard output", error.strerror or str(error)) from error


def print_progress(text: str) -> None:
    """Print a line to standard error, where that is a terminal."""
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


@contextmanager
def bar_of(users: int, ranges: int) -> Iterator[Progress | None]:
    """A progress bar for a registration that takes longer than a second; None but on a terminal."""
    with bar(f"registering {users} users, {ranges} ranges") as progress:
        yield progress


@contextmanager
def bar(what: str) -> Iterator[Progress | None]:
    """A progress bar for what takes longer than a second; None but on a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    columns = min(_terminal_width(), _WIDEST)
    form = "{desc}: {percentage:3.0f} % |{bar}| {elapsed}"
    with tqdm(total=1.0, desc=what, delay=1.0, leave=False, ncols=columns, bar_format=form, file=sys.stderr) as shown:

        def progress(share: float) -> None:
            shown.update(max(share - shown.n, 0.0))

        yield progress


def live_view() -> Callable[[Update], None]:
    """A function that prints each update's events, and below them a line of where everybody stands."""
    began: list[float] = []

    def show(update: Update) -> None:
        began.append(update.t) if not began else None
        for event in update.events:
            print(f"\r\033[K{update.t - began[0]:8.1f} s  {event}", file=sys.stderr)
        line = live_line(update, update.t - began[0], min(_terminal_width(), _WIDEST) - 1)
        print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)

    return show


def live_line(update: Update, elapsed: float, columns: int) -> str:
    """How near everybody is to being registered, in so many columns: a bar each, or who is not yet."""
    bars = "  ".join(f"{name} {_bar(user.progress)}" for name, user in update.users.items())
    line = f"{elapsed:8.1f} s  {bars}"
    if len(line) <= columns:
        return line
    coming = {name: user.progress for name, user in update.users.items() if user.progress < 1.0}
    line = f"{elapsed:8.1f} s  {len(update.users) - len(coming)} of {len(update.users)} registered"
    for name, progress in sorted(coming.items(), key=lambda user: -user[1]):
        more = f"  {name} {progress:.0%}"
        if len(line) + len(more) > columns:
            break
        line += more
    return line[:columns]


def _bar(progress: float) -> str:
    full = round(8 * progress)
    return "█" * full + "░" * (8 - full)


def _terminal_width() -> int:
    return shutil.get_terminal_size().columns
