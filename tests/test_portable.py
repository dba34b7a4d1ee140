"""Recordings are registered where there is nothing of POSIX, and no gtsam: on Windows."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.paths import REPOSITORY

PACKAGE = REPOSITORY / "synchronizar"

# What Python does not have on Windows.
MODULES = {"crypt", "curses", "fcntl", "grp", "nis", "ossaudiodev", "posix", "pty", "pwd", "readline", "resource"}
MODULES |= {"spwd", "syslog", "termios", "tty"}
OF_OS = {"chown", "chroot", "ctermid", "fchmod", "fchown", "fork", "forkpty", "getegid", "geteuid", "getgid"}
OF_OS |= {"getgroups", "getloadavg", "getpgid", "getpgrp", "getpriority", "getsid", "getuid", "killpg", "lchown"}
OF_OS |= {"mkfifo", "mknod", "nice", "openpty", "pathconf", "pipe2", "posix_spawn", "pread", "pwrite", "readv"}
OF_OS |= {"sched_getaffinity", "sched_setaffinity", "sched_yield", "sendfile", "setpgid", "setpriority", "setsid"}
OF_OS |= {"setuid", "statvfs", "sync", "sysconf", "uname", "wait", "wait3", "wait4", "writev"}
OF_SIGNAL = {"SIGALRM", "SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGSTOP", "SIGUSR1", "SIGUSR2"}
OF_SIGNAL |= {"alarm", "pause", "pthread_kill", "setitimer", "sigwait"}
OF_SOCKET = {"AF_UNIX", "SO_REUSEPORT", "socketpair"}
OF_OTHERS = {"os": OF_OS, "signal": OF_SIGNAL, "socket": OF_SOCKET}
# Words that say that something runs on POSIX alone, whatever it is a method of.
ANYWHERE = {"add_reader", "add_signal_handler", "add_writer", "pass_fds", "preexec_fn"}

# What runs on POSIX alone: a room's server, and the air in which the modules' firmware runs.
NOT_THERE = {
    "live/drained_socket.py",
    "live/server.py",
    "live/solver.py",
    "simulation/air.py",
    "simulation/live_air.py",
}
# Asked for only where it is there.
GUARDED = {("estimation/incremental/worker.py", "os.nice"), ("live/estimating.py", "os.nice")}


def posix_words(source: str) -> Iterator[str]:
    """What of POSIX a file names."""
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.Import(names=names):
                yield from (name.name for name in names if name.name in MODULES)
            case ast.ImportFrom(module=str(module), names=names):
                yield from ([module] if module in MODULES else [])
                yield from (f"{module}.{n.name}" for n in names if n.name in OF_OTHERS.get(module, ()))
            case ast.Attribute(value=ast.Name(id=of), attr=name) if name in OF_OTHERS.get(of, ()):
                yield f"{of}.{name}"
            case ast.Attribute(attr=name) | ast.keyword(arg=str(name)) if name in ANYWHERE:
                yield name
            case ast.Constant(value=str(text)) if text.startswith(("/proc/", "/dev/", "/sys/", "/tmp")):
                yield text


def test_nothing_but_a_rooms_server_and_the_simulated_air_names_what_posix_alone_has() -> None:
    found: dict[str, set[str]] = {}
    for file in PACKAGE.rglob("*.py"):
        name = file.relative_to(PACKAGE).as_posix()
        words = {word for word in posix_words(file.read_text(encoding="utf-8")) if (name, word) not in GUARDED}
        if words:
            found[name] = words
    assert set(found) == NOT_THERE, found


def test_words_of_posix_are_found_in_every_form() -> None:
    source = """
import fcntl
from os import fork, getpid
from pwd import getpwnam
def later(loop):
    import os, signal
    os.kill(1, signal.SIGKILL)
    os.nice(5)
    loop.add_signal_handler(signal.SIGINT, f, pass_fds=[3])
    open("/dev/fd/3")
"""
    found = {"fcntl", "os.fork", "pwd", "signal.SIGKILL", "os.nice", "add_signal_handler", "pass_fds", "/dev/fd/3"}
    assert set(posix_words(source)) == found


# Without them; Python itself asks for `posix` and `uname` where it is not on Windows.
WITHOUT = f"""
import importlib, sys
for name in {sorted(MODULES - {"posix"} | {"gtsam"})!r}:
    sys.modules[name] = None
for module, names in {OF_OTHERS!r}.items():
    for name in names - {{"uname"}}:
        vars(importlib.import_module(module)).pop(name, None)
from synchronizar.cli import main
"""


def test_recordings_are_simulated_checked_registered_and_drawn_without_posix_or_gtsam(tmp_path: Path) -> None:
    commands = [
        "simulate walk --users 2 --seconds 15",
        "check walk",
        "register walk --out answer",
        "evaluate walk answer",
        "plot --html walk answer",
        "convert walk walk.pyfg --answer answer",
    ]
    # Files are opened with their encoding: the usual one is not UTF-8 on Windows.
    code = 'import warnings\nwarnings.simplefilter("ignore", EncodingWarning)\n'
    code += 'warnings.filterwarnings("error", "", EncodingWarning, "synchronizar")\n'
    code += WITHOUT + "import synchronizar\nsynchronizar.register, synchronizar.Recording, synchronizar.live.Client\n"
    code += f"for command in {commands!r}:\n    assert main(command.split()) == 0, command\n"
    command = [sys.executable, "-X", "warn_default_encoding", "-c", code]
    run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert (run.returncode, run.stderr) == (0, "")
    assert {"registration.json", "report.html"} <= {path.name for path in (tmp_path / "answer").iterdir()}


@pytest.mark.parametrize("command", ["replay walk", "serve"])
def test_what_needs_gtsam_says_so(command: str, tmp_path: Path) -> None:
    code = f"{WITHOUT}sys.exit(main({command.split()!r}))"
    run = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True)
    needs = f"synchronizar: {command.split()[0]}: needs gtsam, which is not here: it has no wheel for Windows itself"
    assert run.returncode == 2
    assert run.stderr.startswith(needs)
    assert len(run.stderr.splitlines()) == 1
