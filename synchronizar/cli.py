"""The command line. What cannot be used is told in one line; what is heavy is imported when a command needs it."""

from __future__ import annotations

import argparse
import ast
import inspect
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from itertools import pairwise
from math import degrees
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, NoReturn, get_type_hints

from synchronizar.errors import InputError
from synchronizar.simulation.scene import SCHEMES, Scene

if TYPE_CHECKING:
    from synchronizar.data.recording import Recording
    from synchronizar.data.registration import Registration
    from synchronizar.data.updates import Update
    from synchronizar.reporting.evaluate import Evaluation

PROGRAM = "synchronizar"
_WIDEST = 80  # columns of what is drawn on a terminal
FOUND = 1
UNUSABLE = 2
INTERRUPTED = 130
READER_GONE = 141
"""As a shell tells of a program that SIGPIPE ended."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status: 0 done, 2 where the input or an option cannot be used.

    `check` has 1 where it found something.
    """
    try:
        options = _parser().parse_args(argv)
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


_REFERENCE = "whose frame the common one is [the first by name that is not static and moves more than 0.5 m]"


def _example(arguments: str) -> str:
    return f"example: {PROGRAM} {arguments}"


class _Version(argparse.Action):
    """Looks the version up when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        _print(f"{PROGRAM} {version(PROGRAM)}")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Tells a bad option like any other bad input."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        place, _, fault = message.removeprefix("argument ").partition(": ")
        raise InputError(place, fault)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog=PROGRAM,
        description="Puts devices that each run their own SLAM into one frame, from the distances between them.",
        epilog=f"`{PROGRAM} COMMAND --help` tells more. Lengths are in m, angles in degrees (rad in JSON), times in s.",
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    register = commands.add_parser(
        "register", help="find everybody's frame from a recording", epilog=_example("register walk/ --out answer/")
    )
    register.add_argument("recording", metavar="RECORDING", type=Path)
    register.add_argument("--out", metavar="DIR", type=Path, help="write tracks, registration.json and ranges.csv here")
    register.add_argument("--json", action="store_true", help="print registration.json instead of a table")
    register.add_argument("--reference", metavar="USER", help=_REFERENCE)
    register.add_argument(
        "--model", choices=["full", "rigid"], help="what may be wrong with SLAM and radios [full; pairwise: rigid]"
    )
    register.add_argument(
        "--method",
        choices=["joint", "pairwise"],
        default="joint",
        help="all users at once, or two at a time as in the paper [joint]",
    )
    register.set_defaults(command=_register)

    replay = commands.add_parser(
        "replay",
        help="solve a recording in the order of time, nothing seen ahead of its time",
        epilog=_example("replay walk/ --out live/"),
    )
    replay.add_argument("recording", metavar="RECORDING", type=Path)
    replay.add_argument(
        "--out", metavar="DIR", type=Path, help="write causal tracks, registration.json and updates.jsonl here"
    )
    replay.add_argument("--json", action="store_true", help="print registration.json instead of a table")
    replay.add_argument("--reference", metavar="USER", help=_REFERENCE)
    replay.set_defaults(command=_replay)

    evaluate = commands.add_parser(
        "evaluate", help="compare what register wrote with the truth", epilog=_example("evaluate walk/ answer/")
    )
    evaluate.add_argument("recording", metavar="RECORDING", type=Path)
    evaluate.add_argument("out", metavar="DIR", type=Path)
    evaluate.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    evaluate.set_defaults(command=_evaluate)

    check = commands.add_parser(
        "check",
        help="what is in a recording and what looks wrong",
        description="Exit status: 0 nothing found, 1 findings, 2 register refuses it.",
        epilog=_example("check walk/"),
    )
    check.add_argument("recording", metavar="RECORDING", type=Path)
    check.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    check.set_defaults(command=_check)

    simulate = commands.add_parser(
        "simulate",
        help="make a recording, with its truth",
        epilog=_example("simulate walk/ --users 4 --late-share 0.3 --seed 7"),
    )
    simulate.add_argument("recording", metavar="RECORDING", type=Path)
    simulate.add_argument("--force", action="store_true", help="remove what is left there of another walk")
    simulate.add_argument("--modules", action="store_true", help="let the modules' firmware range, in a simulated air")
    simulate.add_argument("--scheme", choices=SCHEMES, help=f"who of the modules sends when [{SCHEMES[0]}]")
    _add_scene_options(simulate)
    simulate.set_defaults(command=_simulate)

    plot = commands.add_parser("plot", help="draw what register wrote", epilog=_example("plot walk/ answer/"))
    plot.add_argument("recording", metavar="RECORDING", type=Path)
    plot.add_argument("out", metavar="DIR", type=Path)
    plot.set_defaults(command=_plot)
    return parser


def _register(options: argparse.Namespace) -> None:
    from synchronizar.io.registration_folder import write_registration

    if options.out is not None:
        _refuse_recordings(options.out)
    recording, registration = _solved(options)
    if options.out is not None:
        write_registration(registration, recording, options.out)
    _tell(registration, options.json)


def _replay(options: argparse.Namespace) -> None:
    from synchronizar.io.registration_folder import write_replay

    if options.out is not None:
        _refuse_recordings(options.out)
    recording, loaded = _loaded(options.recording)
    from synchronizar.estimation.incremental.replay import replay

    with _solvable(options.recording):
        replayed = replay(recording, options.reference, told=_live_view() if sys.stderr.isatty() else None)
    registration = replace(replayed.registration, seconds={**replayed.registration.seconds, "load": loaded})
    if options.out is not None:
        write_replay(replayed._replace(registration=registration), recording, options.out)
    _tell(registration, options.json)


def _check(options: argparse.Namespace) -> int:
    from synchronizar.diagnosis import findings_of
    from synchronizar.diagnosis.solution import spoils
    from synchronizar.diagnosis.summary import summary_of
    from synchronizar.estimation.register import register
    from synchronizar.io.tolerant import read_tolerantly
    from synchronizar.parameters import Parameters
    from synchronizar.reporting.check import check_json, check_table

    _progress(f"loading {options.recording} ...")
    try:
        recording, refused = read_tolerantly(options.recording)
    except InputError as error:
        if options.json:
            _print(json.dumps({"findings": [], "users": {}, "ranges": {}, "refused": str(error)}))
        raise
    parameters = Parameters()
    findings = findings_of(recording, parameters)
    if refused is None and not spoils(findings):
        # What only a solution shows.
        _progress(f"registering {len(recording.users)} users, {len(recording.ranges)} ranges ...")
        try:
            with _solvable(options.recording):
                findings = list(register(recording, parameters=parameters).findings)
        except InputError as error:
            refused = error
    summary = summary_of(recording, parameters)
    if options.json:
        _print(json.dumps(check_json(summary, findings, None if refused is None else str(refused)), allow_nan=False))
    else:
        _print(check_table(summary, findings))
    if refused is not None:
        raise refused
    return FOUND if findings else 0


def _tell(registration: Registration, as_json: bool) -> None:
    from synchronizar.io.registration_folder import registration_json
    from synchronizar.reporting.tables import registration_table

    _print(
        json.dumps(registration_json(registration), allow_nan=False) if as_json else registration_table(registration)
    )


def _loaded(folder: Path) -> tuple[Recording, float]:
    """A recording, and how many seconds that took."""
    from synchronizar.data.recording import Recording

    _progress(f"loading {folder} ...")
    began = perf_counter()
    recording = Recording.load(folder)
    for finding in recording.findings:
        print(f"{PROGRAM}: {folder}: {finding.message}; {finding.remedy}", file=sys.stderr)
    return recording, perf_counter() - began


@contextmanager
def _solvable(recording: Path) -> Iterator[None]:
    """What gtsam throws where a system cannot be solved becomes an InputError that names the recording."""
    try:
        yield
    except RuntimeError as error:
        if type(error) is not RuntimeError:
            raise
        raise InputError(recording, f"cannot be solved: {error}") from error


@contextmanager
def bar_of(users: int, ranges: int) -> Iterator[Callable[[float], None] | None]:
    """A bar for work that takes longer than a second; none but on a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    columns = min(_terminal_width(), _WIDEST)
    told = f"registering {users} users, {ranges} ranges"
    form = "{desc}: {percentage:3.0f} % |{bar}| {elapsed}"
    with tqdm(total=1.0, desc=told, delay=1.0, leave=False, ncols=columns, bar_format=form, file=sys.stderr) as bar:

        def progress(share: float) -> None:
            bar.update(max(share - bar.n, 0.0))

        yield progress


def _live_view() -> Callable[[Update], None]:
    """Events as they come, and below them a line of where everybody stands."""
    began: list[float] = []

    def tell(update: Update) -> None:
        began.append(update.t) if not began else None
        for event in update.events:
            print(f"\r\033[K{update.t - began[0]:8.1f} s  {event}", file=sys.stderr)
        line = live_line(update, update.t - began[0], min(_terminal_width(), _WIDEST) - 1)
        print(f"\r\033[K{line}", end="", file=sys.stderr, flush=True)

    return tell


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


def _refuse_recordings(out: Path) -> None:
    """An answer has a ranges.csv and tracks of the same names as a recording: it must not stand in one's place."""
    folder = out.resolve()
    if _is_recording(folder):
        raise InputError(out, "is a recording: the answer would overwrite its ranges")
    for place in (folder, *folder.parents):
        if place.name in ("tracks", "truth") and _is_recording(place.parent):
            raise InputError(out, f"is a recording's own {place.name}: no place for an answer")


def _is_recording(folder: Path) -> bool:
    return (folder / "tracks").is_dir() and (folder / "ranges.csv").exists()


def _solved(options: argparse.Namespace) -> tuple[Recording, Registration]:
    if options.method == "pairwise" and options.model == "full":
        raise InputError("--model", "the pairwise method trusts SLAM: it has no full model")
    recording, loaded = _loaded(options.recording)
    with _solvable(options.recording), bar_of(len(recording.users), len(recording.ranges)) as progress:
        if options.method == "pairwise":
            from synchronizar.estimation.pairwise.register import register_pairwise

            registration = register_pairwise(recording, options.reference)
        else:
            from synchronizar.estimation.register import register

            registration = register(recording, options.reference, model=options.model or "full", progress=progress)
    return recording, replace(registration, seconds={**registration.seconds, "load": loaded})


def _evaluate(options: argparse.Namespace) -> None:
    from synchronizar.reporting.evaluate import evaluate_folder, evaluation_json

    evaluation = evaluate_folder(options.recording, options.out)
    if options.json:
        _print(json.dumps(evaluation_json(evaluation), allow_nan=False))
    else:
        _print(_evaluation_table(evaluation))


def _evaluation_table(e: Evaluation) -> str:
    """Errors in m and degrees, a row for each alignment to the truth."""
    rows = [
        ("all together", e.joint_ate, e.joint_ate_xy, None),
        (f"{e.reference} alone", e.reference_ate, e.reference_ate_xy, None),
        *((f"{name} in {e.reference}'s", e.transfer[name], e.transfer_xy[name], e.yaw[name]) for name in e.transfer),
    ]
    width = max(len(row[0]) for row in rows)
    lines = [f"{'aligned':{width}}  RMSE (m)  in x, y (m)  yaw (°)"]
    for what, rmse, rmse_xy, yaw in rows:
        turn = None if yaw is None else degrees(yaw)
        lines.append(f"{what:{width}}  {_cell(rmse, '.3f'):>8}  {_cell(rmse_xy, '.3f'):>11}  {_cell(turn, '+.2f'):>9}")
    if e.missing:
        lines.append(f"no estimate of {', '.join(e.missing)}")
    return "\n".join(lines)


def _cell(number: float | None, form: str) -> str:
    return "-" if number is None else format(number, form)


def _simulate(options: argparse.Namespace) -> None:
    scene = Scene(**{f.name: getattr(options, f.name) for f in fields(Scene)})
    if not options.modules:
        if options.scheme is not None:
            raise InputError("--scheme", "is that of modules: it needs --modules")
        from synchronizar.simulation.simulate import simulate

        simulation, heard = simulate(scene), ""
    else:
        from synchronizar.simulation.modules import simulate_modules

        _progress(f"ranging for {scene.seconds:g} s in the simulated air ...")
        told = simulate_modules(scene, options.scheme or SCHEMES[0])
        simulation, heard = told.simulation, f"; {told.datagrams} datagrams, {told.dropped} ranges dropped"
    simulation.save(options.recording, force=options.force)
    users, ranges = simulation.recording.users, simulation.recording.ranges
    _print(f"{options.recording}: {len(users)} users, {len(ranges)} ranges, {simulation.late.sum()} late{heard}")


def _add_scene_options(parser: argparse.ArgumentParser) -> None:
    """An option for each setting of a scene, told as the scene tells it."""
    types, told = get_type_hints(Scene), _field_docstrings()
    for f in fields(Scene):
        option, kind = f"--{f.name.replace('_', '-')}", types[f.name]
        said = told[f.name].replace("`", "").replace("%", "%%")
        if kind is bool:
            parser.add_argument(option, action="store_true", help=said)
            continue
        read = {int: int, str: str, float: float, float | None: float}.get(kind, _words)
        shown = ",".join(f.default) if isinstance(f.default, tuple) else f.default
        metavar = {int: "N", str: "WORD", _words: "WORDS"}.get(read, "X")
        parser.add_argument(option, type=read, default=f.default, metavar=metavar, help=f"{said} [{shown}]")


def _field_docstrings() -> dict[str, str]:
    """The string below each field of Scene."""
    told = {}
    for statement, following in pairwise(ast.iter_child_nodes(ast.parse(inspect.getsource(Scene)).body[0])):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(docstring))):
                told[name] = inspect.cleandoc(docstring)
    return told


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))


def _plot(options: argparse.Namespace) -> None:
    from synchronizar.data.recording import Recording
    from synchronizar.reporting.plots import plot

    _progress(f"loading {options.recording} ...")
    recording = Recording.load(options.recording)
    _print(str(plot(recording, options.out, options.recording.resolve().name)))


def _print(text: str) -> None:
    """To standard output, whatever its encoding; a fault is told at once and not when Python ends."""
    encoding = sys.stdout.encoding or "utf-8"
    try:
        print(text.encode(encoding, "backslashreplace").decode(encoding), flush=True)
    except OSError as error:
        # What is left in the buffer would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise InputError("standard output", error.strerror or str(error)) from error


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)
