"""The options of each command."""

from __future__ import annotations

import argparse
import ast
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, get_type_hints

from synchronizar.cli.terminal import print_result
from synchronizar.convert.asked import ANGLE_UNITS, LENGTH_UNITS, STAMPS, TIME_UNITS
from synchronizar.convert.formats import READ, WRITTEN
from synchronizar.errors import InputError
from synchronizar.simulation.scene import SCHEMES, Scene

PROGRAM = "synchronizar"
Command = Callable[[argparse.Namespace], "int | None"]
_REFERENCE = "whose frame the common one is [the first by name that is not static and moves more than 0.5 m]"


def _example(arguments: str) -> str:
    return f"example: {PROGRAM} {arguments}"


class _Version(argparse.Action):
    """Looks the version up when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="print the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> NoReturn:
        from importlib.metadata import version

        print_result(f"{PROGRAM} {version(PROGRAM)}")
        parser.exit()


class _Parser(argparse.ArgumentParser):
    """Reports a bad option like any other bad input."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(allow_abbrev=False, **settings)

    def error(self, message: str) -> NoReturn:
        place, _, fault = message.removeprefix("argument ").partition(": ")
        raise InputError(place, fault)


def parser_of(commands_by_name: Mapping[str, Command]) -> argparse.ArgumentParser:
    """The parser of all options; `command` of what it parses is the command that was named."""
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
    register.set_defaults(command=commands_by_name["register"])

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
    replay.set_defaults(command=commands_by_name["replay"])

    evaluate = commands.add_parser(
        "evaluate", help="compare what register wrote with the truth", epilog=_example("evaluate walk/ answer/")
    )
    evaluate.add_argument("recording", metavar="RECORDING", type=Path)
    evaluate.add_argument("out", metavar="DIR", type=Path)
    evaluate.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    evaluate.set_defaults(command=commands_by_name["evaluate"])

    check = commands.add_parser(
        "check",
        help="what is in a recording and what looks wrong",
        description="Exit status: 0 nothing found, 1 findings, 2 register refuses it.",
        epilog=_example("check walk/"),
    )
    check.add_argument("recording", metavar="RECORDING", type=Path)
    check.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    check.set_defaults(command=commands_by_name["check"])

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
    simulate.set_defaults(command=commands_by_name["simulate"])

    _add_convert(commands, commands_by_name["convert"])
    plot = commands.add_parser("plot", help="draw what register wrote", epilog=_example("plot walk/ answer/"))
    plot.add_argument("recording", metavar="RECORDING", type=Path)
    plot.add_argument("out", metavar="DIR", type=Path)
    plot.add_argument("--rerun", action="store_true", help="write answer.rrd instead, which rerun shows")
    plot.add_argument(
        "--html", action="store_true", help="write report.html instead: one file, in which one can look closer"
    )
    plot.set_defaults(command=commands_by_name["plot"])
    _add_live_commands(commands, commands_by_name)
    return parser


def _add_convert(commands: Any, command: Command) -> None:
    convert = commands.add_parser(
        "convert",
        help="make a recording of other formats, or write one, and an answer about it, in another format",
        description="Where SOURCE is a recording, it is written in another format; anything else becomes a recording.",
        epilog=f"{_example('convert walk.bag walk/')}; {PROGRAM} convert walk/ walk.mcap --answer answer/",
    )
    convert.add_argument("source", metavar="SOURCE", type=Path, help="a bag, a log, a folder of them; or a recording")
    convert.add_argument("out", metavar="RECORDING", type=Path, nargs="?", help="what is made: a folder, or a file")
    convert.add_argument("--from", dest="from_format", choices=READ, help="what SOURCE is [found out]")
    convert.add_argument("--to", choices=("recording", *WRITTEN), help="what is made [what its name ends with]")
    convert.add_argument("--answer", metavar="DIR", type=Path, help="out: what register or replay wrote about it")
    convert.add_argument(
        "--json", action="store_true", help="in: print one JSON object instead of sentences and tables"
    )
    convert.add_argument("--force", action="store_true", help="in: replace the recording that is there")
    convert.add_argument("--add", action="store_true", help="in: add to the recording that is there")
    said = convert.add_argument_group("what SOURCE does not say", "docs/formats.md tells what each format assumes")
    said.add_argument("--list", action="store_true", help="print what is in SOURCE and what is guessed of it, no more")
    said.add_argument("--user", metavar="NAME", help="whose track it is, where a file has one [the file's name]")
    said.add_argument("--length-unit", choices=tuple(LENGTH_UNITS), help="of positions")
    said.add_argument("--time-unit", choices=tuple(TIME_UNITS), help="of stamps")
    said.add_argument("--time-offset", type=float, default=0.0, metavar="S", help="added to all stamps (s)")
    said.add_argument("--rate", type=_speed, metavar="HZ", help="lines a second of a log without stamps")
    said.add_argument("--angle-unit", choices=ANGLE_UNITS, help="of angles, where attitudes are some")
    said.add_argument("--quaternion", choices=("xyzw", "wxyz"), help="order of a quaternion's columns")
    said.add_argument("--sigma", action="store_true", help="take the noise that SOURCE says its ranges have")
    said.add_argument(
        "--column",
        dest="columns",
        metavar="NAME=COLUMN",
        type=_pair,
        action="append",
        default=[],
        help="the same for one column",
    )
    _add_said_of_messages(said)
    convert.set_defaults(command=command)


def _add_said_of_messages(said: argparse._ArgumentGroup) -> None:
    """What is said of a bag's messages, and of those that come live."""
    said.add_argument(
        "--rename", dest="renamed", metavar="OLD=NEW", type=_pair, action="append", default=[], help="call a device so"
    )
    said.add_argument("--static", metavar="NAME", action="append", default=[], help="a radio that stands still")
    said.add_argument(
        "--without", dest="left_out", metavar="NAME", action="append", default=[], help="leave a device out"
    )
    said.add_argument("--world", metavar="AXES", help="axes of positions: ros, ned, optical, arkit, unity, ... or rdf")
    said.add_argument("--body", metavar="AXES", help="axes of the device, which become x forward, y left, z up")
    said.add_argument("--range-unit", choices=tuple(LENGTH_UNITS), help="of ranges")
    said.add_argument("--stamps", choices=STAMPS, help="a message's own stamp, or when it was logged")
    said.add_argument("--map", metavar="TOML", type=Path, help="what topics, fields, columns and radios are")
    said.add_argument(
        "--topic",
        dest="topics",
        metavar="'TOPIC KEY=VALUE ...'",
        action="append",
        default=[],
        help="the same for one topic",
    )


def _pair(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise argparse.ArgumentTypeError(f"{text} is not A=B")
    return old, new


def _add_live_commands(commands: Any, commands_by_name: Mapping[str, Command]) -> None:
    serve = commands.add_parser("serve", help="open a room that devices join", epilog=_example("serve --record rooms/"))
    serve.add_argument("--host", metavar="ADDRESS", help="listen at this address alone [all of this machine's]")
    serve.add_argument("--port", type=_port, default=47180, metavar="N", help="TCP port; 0: any that is free [47180]")
    serve.add_argument("--udp-port", type=_port, default=47190, metavar="N", help="port for modules' ranges [47190]")
    serve.add_argument("--record", type=Path, metavar="DIR", help="write each room into a folder here as it goes")
    serve.add_argument("--resume", action="store_true", help="go on with the rooms that were recorded in DIR")
    serve.add_argument("--certificate", type=Path, metavar="PEM", help="certificate and key [self-signed, made once]")
    serve.add_argument(
        "--public-url", metavar="URL", help="under which others reach it, behind a proxy [its own address]"
    )
    serve.add_argument("--no-tls", action="store_true", help="plain http; with --host 127.0.0.1 alone")
    serve.add_argument(
        "--allow-version-1", action="store_true", help="take modules that all sign with the room's own key"
    )
    serve.add_argument(
        "--keep-awake",
        action="store_true",
        help="modules range all the time [they sleep while nobody needs ranges]",
    )
    serve.add_argument(
        "--app", metavar="NAME", help="what people do in its rooms: catch, treasure, eyes, robot, or your own"
    )
    serve.add_argument("--json", action="store_true", help="print one line of JSON once it listens")
    serve.set_defaults(command=commands_by_name["serve"])

    play = commands.add_parser(
        "play",
        help="let a recording's devices join a room as if they were there",
        epilog=_example("play walk/ https://192.168.1.5:47180/#ABCD2345 --speed 4"),
    )
    play.add_argument("recording", metavar="RECORDING", type=Path)
    play.add_argument("join", metavar="JOIN", help="the address by which phones join, as serve prints it")
    play.add_argument("--speed", type=_speed, default=1.0, metavar="X", help="times the speed of the recording [1]")
    play.add_argument("--json", action="store_true", help="print registration.json instead of a table")
    play.set_defaults(command=commands_by_name["play"])

    ros = commands.add_parser(
        "ros",
        help="let robots with ROS join a room, by rosbridge, and tell them where they are",
        epilog=_example("ros https://192.168.1.5:47180/#ABCD2345 --bridge ws://robot:9090"),
    )
    ros.add_argument("join", metavar="JOIN", help="the address by which phones join, as serve prints it")
    ros.add_argument(
        "--bridge",
        dest="bridges",
        metavar="[NAME=]URL",
        type=_bridge,
        action="append",
        help="a rosbridge; NAME: of the one robot there; may be said several times [ws://127.0.0.1:9090]",
    )
    ros.add_argument("--common", metavar="FRAME", default="common", help="name of the common frame in TF [common]")
    ros.add_argument(
        "--sim-time", action="store_true", help="the room's time goes by stamps: of a simulation, or a bag"
    )
    ros.add_argument("--list", action="store_true", help="print what topics there are and what is guessed, no more")
    _add_said_of_messages(ros.add_argument_group("what messages do not say", "as for convert; docs/ros.md"))
    ros.set_defaults(command=commands_by_name["ros"])


def _bridge(text: str) -> tuple[str | None, str]:
    name, equals, address = text.partition("=")
    return (name, address) if equals and "://" not in name else (None, text)


def _port(text: str) -> int:
    port = int(text)
    if not 0 <= port <= 65535:
        raise argparse.ArgumentTypeError(f"{port} is no port: 0 to 65535")
    return port


def _speed(text: str) -> float:
    speed = float(text)
    if not speed > 0.0:
        raise argparse.ArgumentTypeError("it must be a number above 0")
    return speed


def _add_scene_options(parser: argparse.ArgumentParser) -> None:
    """Add an option for each setting of a scene, described by the docstring of its field."""
    types, described = get_type_hints(Scene), _field_docstrings()
    for f in fields(Scene):
        option, kind = f"--{f.name.replace('_', '-')}", types[f.name]
        description = described[f.name].replace("`", "").replace("%", "%%")
        if kind is bool:
            parser.add_argument(option, action="store_true", help=description)
            continue
        read = {int: int, str: str, float: float, float | None: float}.get(kind, _words)
        shown = ",".join(f.default) if isinstance(f.default, tuple) else f.default
        metavar = {int: "N", str: "WORD", _words: "WORDS"}.get(read, "X")
        parser.add_argument(option, type=read, default=f.default, metavar=metavar, help=f"{description} [{shown}]")


def _field_docstrings() -> dict[str, str]:
    """The string below each field of Scene."""
    described = {}
    for statement, following in pairwise(ast.iter_child_nodes(ast.parse(inspect.getsource(Scene)).body[0])):
        match statement, following:
            case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(docstring))):
                described[name] = inspect.cleandoc(docstring)
    return described


def _words(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))
