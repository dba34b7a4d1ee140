"""The command line. Heavy imports wait until a command needs them."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from synchronizar.cli.commands import COMMANDS
from synchronizar.cli.parser import PROGRAM, parser_of
from synchronizar.errors import InputError

UNUSABLE = 2
INTERRUPTED = 130
READER_GONE = 141
"""As a shell reports a program that SIGPIPE ended."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 2 where the input or an option cannot be used.

    `check` has 1 where it found something.
    """
    try:
        options = parser_of(COMMANDS).parse_args(argv)
        status: int | None = options.command(options)
    except InputError as error:
        print(f"{PROGRAM}: {error}", file=sys.stderr)
        return UNUSABLE
    except MemoryError:
        print(f"{PROGRAM}: memory: there is not enough of it for this", file=sys.stderr)
        return UNUSABLE
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        return READER_GONE
    return status or 0
