"""What each command does."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

from synchronizar.cli.parser import PROGRAM
from synchronizar.cli.terminal import bar, bar_of, live_view, print_progress, print_result
from synchronizar.errors import InputError
from synchronizar.progress import unheard
from synchronizar.simulation.scene import SCHEMES, Scene

if TYPE_CHECKING:
    from synchronizar.cli.parser import Command
    from synchronizar.convert.asked import Asked
    from synchronizar.convert.importing import Part
    from synchronizar.data.exported import Exported
    from synchronizar.data.findings import Finding
    from synchronizar.data.recording import Recording
    from synchronizar.data.registration import Registration
    from synchronizar.diagnosis.summary import Summary

FOUND = 1
_SAMPLED_S = 3.0
"""s for which `ros --list` hears what comes."""


def _register(options: argparse.Namespace) -> None:
    from synchronizar.io.registration_folder import write_registration

    if options.out is not None:
        _refuse_recordings(options.out)
    recording, registration = _solved(options)
    if options.out is not None:
        write_registration(registration, recording, options.out)
    _print_registration(registration, options.json)


def _replay(options: argparse.Namespace) -> None:
    from synchronizar.io.registration_folder import write_replay

    if options.out is not None:
        _refuse_recordings(options.out)
    _need_gtsam("replay")
    recording, loaded = _loaded(options.recording)
    from synchronizar.estimation.incremental.replay import replay

    with _solvable(options.recording):
        replayed = replay(recording, options.reference, told=live_view() if sys.stderr.isatty() else None)
    registration = replace(replayed.registration, seconds={**replayed.registration.seconds, "load": loaded})
    if options.out is not None:
        write_replay(replayed._replace(registration=registration), recording, options.out)
    _print_registration(registration, options.json)


def _check(options: argparse.Namespace) -> int:
    from synchronizar.reporting.check import check_json, check_table

    try:
        summary, findings, refused = _checked(options.recording)
    except InputError as error:
        if options.json:
            print_result(json.dumps({"findings": [], "users": {}, "ranges": {}, "refused": str(error)}))
        raise
    if options.json:
        print_result(
            json.dumps(check_json(summary, findings, None if refused is None else str(refused)), allow_nan=False)
        )
    else:
        print_result(check_table(summary, findings, refused is not None))
    if refused is not None:
        raise refused
    return FOUND if findings else 0


def _checked(folder: Path) -> tuple[Summary, list[Finding], InputError | None]:
    """What is in a recording, what looks wrong in it, and why `register` refuses it, if it does."""
    from synchronizar.diagnosis import findings_of
    from synchronizar.diagnosis.solution import spoils
    from synchronizar.diagnosis.summary import summary_of
    from synchronizar.estimation.register import register
    from synchronizar.io.tolerant import read_tolerantly
    from synchronizar.parameters import Parameters

    print_progress(f"loading {folder} ...")
    recording, refused = read_tolerantly(folder)
    parameters = Parameters()
    findings = findings_of(recording, parameters)
    if refused is None and not spoils(findings):
        # What only a solution shows.
        print_progress(f"registering {len(recording.users)} users, {len(recording.ranges)} ranges ...")
        try:
            with _solvable(folder):
                findings = list(register(recording, parameters=parameters).findings)
        except InputError as error:
            refused = error
    return summary_of(recording, parameters), findings, refused


def _print_registration(registration: Registration, as_json: bool) -> None:
    from synchronizar.io.registration_folder import registration_json
    from synchronizar.reporting.tables import registration_table

    print_result(
        json.dumps(registration_json(registration), allow_nan=False) if as_json else registration_table(registration)
    )


def _loaded(folder: Path) -> tuple[Recording, float]:
    """A recording, and how many seconds that took."""
    from synchronizar.data.recording import Recording

    print_progress(f"loading {folder} ...")
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


def _refuse_recordings(out: Path) -> None:
    """An answer has a ranges.csv and tracks of the same names as a recording: it must not stand in one's place."""
    from synchronizar.io.recording_folder import is_recording

    folder = out.resolve()
    if is_recording(folder):
        raise InputError(out, "is a recording: the answer would overwrite its ranges")
    for place in (folder, *folder.parents):
        if place.name in ("tracks", "truth") and is_recording(place.parent):
            raise InputError(out, f"is a recording's own {place.name}: no place for an answer")


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
    from synchronizar.reporting.tables import evaluation_table

    evaluation = evaluate_folder(options.recording, options.out)
    if options.json:
        print_result(json.dumps(evaluation_json(evaluation), allow_nan=False))
    else:
        print_result(evaluation_table(evaluation))


def _simulate(options: argparse.Namespace) -> None:
    scene = Scene(**{f.name: getattr(options, f.name) for f in fields(Scene)})
    if not options.modules:
        if options.scheme is not None:
            raise InputError("--scheme", "is that of modules: it needs --modules")
        from synchronizar.simulation.simulate import simulate

        simulation, heard = simulate(scene), ""
    else:
        from synchronizar.simulation.modules import simulate_modules

        print_progress(f"ranging for {scene.seconds:g} s in the simulated air ...")
        ranged = simulate_modules(scene, options.scheme or SCHEMES[0])
        simulation, heard = ranged.simulation, f"; {ranged.datagrams} datagrams, {ranged.dropped} ranges dropped"
    simulation.save(options.recording, force=options.force)
    users, ranges = simulation.recording.users, simulation.recording.ranges
    print_result(f"{options.recording}: {len(users)} users, {len(ranges)} ranges, {simulation.late.sum()} late{heard}")


def _plot(options: argparse.Namespace) -> None:
    (recording, _), name = _loaded(options.recording), options.recording.resolve().name
    if options.html:
        from synchronizar.reporting.report import write_report

        print_result(str(write_report(recording, options.out, name)))
    elif options.rerun:
        write = _writer("rerun")
        write(options.out / "answer.rrd", _answer(options.out, recording))
        print_result(str(options.out / "answer.rrd"))
    else:
        from synchronizar.reporting.plots import plot

        for file in plot(recording, options.out, name):
            print_result(str(file))


def _convert(options: argparse.Namespace) -> None:
    from synchronizar.convert.asked import Asked
    from synchronizar.io.recording_folder import is_recording

    of_asked = [f.name for f in fields(Asked)]
    if options.from_format is None and is_recording(options.source):
        _refuse_options(options, (*of_asked, "list", "json", "force", "add"), f"{options.source} is a recording itself")
        _convert_out(options)
    else:
        _refuse_options(options, ["answer"], f"{options.source} is no recording: there is no answer about it")
        _convert_in(options)


def _refuse_options(options: argparse.Namespace, names: Iterable[str], fault: str) -> None:
    """Raise InputError for the first option of these that was said: it would do nothing."""
    flags = {"columns": "column", "topics": "topic", "renamed": "rename", "left_out": "without"}
    for name in names:
        if getattr(options, name) not in (None, False, 0.0, []):
            raise InputError(f"--{flags.get(name, name).replace('_', '-')}", f"does nothing here: {fault}")


def _convert_out(options: argparse.Namespace) -> None:
    """Write a recording, and an answer about it, in another format."""
    from synchronizar.convert.formats import FORMATS, WRITTEN
    from synchronizar.data.exported import Exported

    if options.to == "recording":
        raise InputError("--to", f"{options.source} is a recording already")
    if options.out is None:
        raise InputError(options.source, "is a recording: say where it is to be written, and in what format")
    named = options.to or next((f.name for f in FORMATS if options.out.suffix in f.suffixes), None)
    if named is None:
        known = ", ".join(suffix for f in FORMATS for suffix in f.suffixes)
        raise InputError(
            options.out, f"has no name that says its format: let it end with {known}, or say --to {'|'.join(WRITTEN)}"
        )
    write = _writer(named)
    recording, _ = _loaded(options.source)
    write(options.out, Exported(recording) if options.answer is None else _answer(options.answer, recording))
    print_result(str(options.out))


def _writer(name: str) -> Callable[[Path, Exported], None]:
    """What writes a format. Raises InputError where what it needs is not installed."""
    from synchronizar.convert.formats import format_named

    target = format_named(name)
    if target.writer_extra:
        extra, module = target.writer_extra
        with _extra(extra):
            import_module(module)
    return target.writing()


def _answer(folder: Path, recording: Recording) -> Exported:
    """A recording, and what `register` or `replay` wrote about it; updates are of a replay."""
    from synchronizar.data.exported import Exported
    from synchronizar.io.registration_reader import read_registration
    from synchronizar.io.updates_jsonl import UPDATES_FILE, read_updates

    replayed = (folder / UPDATES_FILE).exists()
    registration, tracks = read_registration(folder, recording, causal=replayed)
    updates = read_updates(folder / UPDATES_FILE, recording) if replayed else []
    return Exported(recording, registration, tracks, updates)


def _convert_in(options: argparse.Namespace) -> None:
    """Make a recording of something else, and check it."""
    from synchronizar.convert import importing
    from synchronizar.convert.asked import Asked
    from synchronizar.convert.saving import check_place

    asked = Asked(**{f.name: getattr(options, f.name) for f in fields(Asked)})
    parts, unknown = importing.parts_of(options.source, options.from_format)
    if options.list:
        for part in parts:
            with _extra(part.format.reader_extra):
                print_result(importing.listing(part, asked))
        return
    if options.out is None:
        raise InputError(options.source, "say where the recording is to be written: convert SOURCE RECORDING")
    if options.to not in (None, "recording"):
        raise InputError("--to", f"{options.source} has to become a recording before it is written as {options.to}")
    check_place(options.out, options.force or options.add)
    # All that was read is let go of before it is read again, to be checked.
    notes = _save_imported(options, asked, parts, unknown)
    _print_conversion(options, [part.format.name for part in parts], notes)


def _save_imported(options: argparse.Namespace, asked: Asked, parts: list[Part], unknown: list[Path]) -> list[str]:
    """Write the recording; returns what was taken for granted."""
    from synchronizar.convert import importing
    from synchronizar.convert.saving import save
    from synchronizar.io.recording_folder import is_recording

    with ExitStack() as needs, bar(f"reading {options.source}") as progress:
        for part in parts:
            needs.enter_context(_extra(part.format.reader_extra))
        imported = importing.read_parts(options.source, parts, unknown, asked, progress or unheard)
    added_to = options.out if options.add and is_recording(options.out) else None
    recording, truth, notes = importing.recording_of(options.source, imported, asked, added_to)
    save(recording, truth, options.out)
    return notes


def _print_conversion(options: argparse.Namespace, formats: list[str], notes: list[str]) -> None:
    """What was taken for granted, and what `check` finds in what was made."""
    from synchronizar.reporting.check import check_json, check_table

    summary, findings, refused = _checked(options.out)
    if options.json:
        told = check_json(summary, findings, None if refused is None else str(refused))
        head = {"recording": str(options.out), "formats": sorted(set(formats)), "notes": notes}
        print_result(json.dumps({**head, **told}, allow_nan=False))
        return
    print_result("\n".join([f"{options.source}: {', '.join(sorted(set(formats)))}", *(f"- {n}" for n in notes), ""]))
    print_result(check_table(summary, findings, refused is not None))
    print_result(f"\n{options.out}" if refused is None else f"{refused}\n\n{options.out}")


def _serve(options: argparse.Namespace) -> None:
    _need_gtsam("serve")
    with _extra("live"):
        from synchronizar.live.server import ServerOptions, announce, serve
    import asyncio

    asked = ServerOptions(
        host=options.host,
        port=options.port,
        udp_port=options.udp_port,
        allow_version_1=options.allow_version_1,
        keep_awake=options.keep_awake,
        record=options.record,
        resume=options.resume,
        public_url=options.public_url,
        certificate=options.certificate,
        tls=not options.no_tls,
        json=options.json,
        app=options.app,
    )
    asyncio.run(serve(asked, lambda where: announce(where, asked)))


def _play(options: argparse.Namespace) -> None:
    with _extra("live"):
        from synchronizar.live.play import play
        from synchronizar.live.words_file import read_words
    import asyncio

    recording, _ = _loaded(options.recording)
    try:
        answer = asyncio.run(play(recording, options.join, options.speed, words=read_words(options.recording)))
    except ConnectionError as error:
        raise InputError(options.join.partition("#")[0], str(error)) from error
    from synchronizar.reporting.tables import answer_table

    print_result(json.dumps(answer, allow_nan=False) if options.json else answer_table(answer))


def _need_gtsam(command: str) -> None:
    """Who walks is followed by gtsam, which comes with the package where it has wheels: not for Windows."""
    if find_spec("gtsam") is None:
        raise InputError(command, "needs gtsam, which is not here: it has no wheel for Windows itself, but for WSL")


def _ros(options: argparse.Namespace) -> None:
    with _extra("live"):
        from synchronizar.ros.bridge import Bridge, list_topics
        from synchronizar.ros.options import BridgeOptions
    import asyncio

    from synchronizar.convert.asked import Asked

    asked = Asked(**{f.name: getattr(options, f.name) for f in fields(Asked) if hasattr(options, f.name)})
    bridges = options.bridges or [(None, "ws://127.0.0.1:9090")]
    wanted = BridgeOptions(options.join, bridges, asked, options.common, options.sim_time)
    if options.list:
        print_result(asyncio.run(list_topics(wanted, _SAMPLED_S)))
    else:
        asyncio.run(Bridge(wanted).run())


@contextmanager
def _extra(name: str) -> Iterator[None]:
    """What only some commands need comes with an extra; an empty name is none."""
    try:
        yield
    except ModuleNotFoundError as error:
        if not name:
            raise
        raise InputError(error.name or name, f"is not installed: pip install 'synchronizar[{name}]'") from error


COMMANDS: dict[str, Command] = {
    "register": _register,
    "replay": _replay,
    "evaluate": _evaluate,
    "check": _check,
    "simulate": _simulate,
    "plot": _plot,
    "convert": _convert,
    "serve": _serve,
    "play": _play,
    "ros": _ros,
}
