from __future__ import annotations

import json
import re
import sys
import sysconfig
import textwrap
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.air_built import needs_air
from support.datagrams import some_ranges
from support.paths import REPOSITORY

from synchronizar.cli import main
from synchronizar.data.ranges import SOURCES
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.io.datagrams import RangesDatagram, encode_ranges, reporter_key
from synchronizar.io.receiver import Receiver, stamp_all
from synchronizar.simulation import air, collect, modules
from synchronizar.simulation.modules import CRYSTAL_PPM, MOST_M, Heard, simulate_modules
from synchronizar.simulation.scenario import MOST_MODULES, Blocked, Module, Scenario
from synchronizar.simulation.scene import SCHEMES, Scene
from synchronizar.simulation.simulate import simulate

WALK = Scene(users=3, seconds=4.0, seed=5)
PRECISE = replace(WALK, sigma=0.0)
HERE = np.zeros((1, 3))
WORD = encode_ranges(RangesDatagram(3, 3, 1, 13, 0, 0, some_ranges([4], [1000])), reporter_key(bytes(32), 3, 3))
ONE = Scenario(1.0, "one-to-n", 2, 3, bytes(32), 0.01, 0.1, [Module(1.5, -2.5, 0.25, np.zeros(1), HERE)])


def pairs(heard: Heard) -> set[tuple[int, int]]:
    ranges = heard.simulation.recording.ranges
    return {(min(ab), max(ab)) for ab in zip(ranges.a.tolist(), ranges.b.tolist(), strict=True)}


# What cannot be had


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--modules", "--scheme", "round-robin"], "--scheme: invalid choice: 'round-robin'"),
        (["--scheme", "polling"], "--scheme: is that of modules: it needs --modules"),
        (["--modules", "--links", "star"], "--links: modules range with everybody"),
        (["--modules", "--antennas", "2"], "--antennas: a module has one"),
        (["--modules", "--rate-hz", "10"], "--rate-hz: does not go with --modules"),
        (["--modules", "--users", "10", "--static-radios", "2"], "--users: --modules are at most 11"),
        (["--modules", "--sigma", "20"], "--sigma: is at most 5 m with --modules, not 20"),
        (["--modules", "--bias-sigma", "30"], "--bias-sigma: is at most 1 m with --modules, not 30"),
        (["--modules", "--late-mean", "1e7"], "--late-mean: is at most 100 m with --modules, not 1e+07"),
        (["--modules", "--area", "1e7"], "--area: is at most 1000 m with --modules, not 1e+07"),
        (["--modules", "--height=-1e7"], "--height: is at most 1000 m with --modules, not -1e+07"),
    ],
)
def test_what_modules_cannot_do_is_refused_in_one_line(
    options: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", str(tmp_path / "walk"), *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(f"synchronizar: {told}")
    assert len(err.splitlines()) == 1
    assert not (tmp_path / "walk").exists()


# The air's program


def test_a_scenario_is_written_as_the_program_reads_it() -> None:
    still = Module(-20.0, 20.0, 0.0, np.array([0.0, 0.5]), np.array([[1.0, 2.0, 3.0], [1.0, 2.5, 3.0]]), 0.75, 0.125)
    pair = (np.array([0], dtype=np.int32), np.array([1], dtype=np.int32))
    blocked = Blocked(*pair, np.array([0.25]), np.array([0.5]), np.array([1.5]))
    assert replace(ONE, modules=[*ONE.modules, still], blocked=blocked).text() == textwrap.dedent(
        f"""\
        air 1
        seed 2
        seconds 1.0
        scheme one-to-n
        session 3
        channel 5
        prf 64
        range_s 0
        sleep_s 0
        stamp_sigma 0.01
        frame_loss 0.1
        node 0 ppm 1.5 board_ppm -2.5 on 0.25 off inf antenna_delay_error 0.0 temperature 23.0
        key 0 {reporter_key(bytes(32), 3, 0).hex()}
        at 0 0.0 0.0 0.0 0.0
        node 1 ppm -20.0 board_ppm 20.0 on 0.0 off 0.75 antenna_delay_error 0.125 temperature 23.0
        key 1 {reporter_key(bytes(32), 3, 1).hex()}
        at 1 0.0 1.0 2.0 3.0
        at 1 0.5 1.0 2.5 3.0
        late 0 1 0.25 0.5 1.5
        """
    )


@pytest.fixture
def pretend(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Puts a program in the place of the air's: `say(line)`, `send(payload)`, `heard()` and `fault(line)` are there.

    WORD is a datagram of module 3.
    """

    def put(body: str) -> None:
        program = tmp_path / air.PROGRAM
        head = f"""
            import socket, sys, time
            WORD = {WORD!r}
            port = int(sys.argv[sys.argv.index("--port") + 1])
            way = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            def say(line): print(line, flush=True)
            def raw(octets): sys.stdout.buffer.write(octets); sys.stdout.flush()
            def send(payload): way.sendto(payload, ("127.0.0.1", port))
            def heard(): return sys.stdin.readline()
            def fault(line): print(line, file=sys.stderr)
        """
        program.write_text(f"#!{sys.executable}\n" + textwrap.dedent(head) + textwrap.dedent(body))
        program.chmod(0o755)
        monkeypatch.setattr(sysconfig, "get_path", lambda _: str(tmp_path))
        monkeypatch.setattr(air, "WAIT_S", 0.2)

    return put


def test_all_that_happens_comes_in_its_order_and_each_datagram_is_answered(pretend) -> None:
    pretend(
        """
        assert "--frames" in sys.argv
        say("said 0.1 node 3 looks for others")
        send(WORD); say(f"sent 0.2 3 {len(WORD)} 0.15")
        if heard() != "\\n": sys.exit(7)
        say("frame 0.3 0.4 3 1 word"); say("frame 0.5 0.6 4 - join")
        say("done")
        """
    )
    assert list(air.events(ONE, frames=True)) == [
        air.Datagram(0.2, WORD, 0.15),
        air.Frame(0.3, 0.4, 3, 1, "word"),
        air.Frame(0.5, 0.6, 4, None, "join"),
    ]


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ("say('sent 0.2 3 4 -')", "said that it sent a datagram of 3, and none came within 0.2 s"),
        ("send(WORD); say('sent 0.2 3 5 -')", "said that it sent a datagram of 3, and none came within 0.2 s"),
        (
            "send(WORD); say('sent 0.2 4 80 -')",
            "said that it sent a datagram of 4, and none came within 0.2 s",
        ),
        ("say('hello')", "said 'hello', which means nothing here"),
        ("say('sent 0.2 three 4 -')", "invalid literal for int() with base 10: 'three'"),
        ("say('frame soon 0.4 3 1 word')", "could not convert string to float: 'soon'"),
        (r"raw(b'\xff\n')", r"said '\xff', which means nothing here"),
        ("pass", "ended with status 0 before it was done"),
        ("say('done'); sys.exit(3)", "ended with status 3"),
        ("fault('scenario:3: the key is missing'); sys.exit(2)", "scenario:3: the key is missing"),
        ("fault('synchronizar-air: ' + sys.argv[1] + ':4: so what?'); sys.exit(2)", "scenario:4: so what?"),
        ("send(WORD); say(f'sent 0.2 3 {len(WORD)} -'); sys.exit(1)", "ended with status 1 before it was done"),
    ],
)
def test_a_program_that_does_not_do_as_agreed_is_told_in_one_line(pretend, body: str, told: str) -> None:
    pretend(body)
    with pytest.raises(InputError) as caught:
        list(air.events(ONE))
    assert str(caught.value) == f"synchronizar-air: {told}"


def test_what_the_system_does_not_give_is_told_in_one_line(pretend, monkeypatch: pytest.MonkeyPatch) -> None:
    pretend("say('done')")
    monkeypatch.setattr(air, "HOST", "192.0.2.1")  # of nobody: RFC 5737
    with pytest.raises(InputError, match=r"^synchronizar-air: .*address"):
        list(air.events(ONE))


def test_a_program_that_cannot_be_run_is_told_in_one_line(pretend, tmp_path: Path) -> None:
    pretend("say('done')")
    (tmp_path / air.PROGRAM).write_text("#!/nowhere\n")
    with pytest.raises(InputError, match=r"^synchronizar-air: .*No such file"):
        list(air.events(ONE))


def test_what_strangers_send_is_passed_over(pretend) -> None:
    pretend(
        """
        other = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        for stray in (b"", b"hello", bytes(len(WORD)), WORD[:-1] + bytes([WORD[-1] ^ 1])):
            other.sendto(stray, ("127.0.0.1", port))
        send(WORD); say(f"sent 0.2 3 {len(WORD)} -")
        heard()
        say("done")
        """
    )
    (event,) = air.events(ONE)
    assert isinstance(event, air.Datagram)
    assert event.payload == WORD
    assert np.isnan(event.measured)


def test_the_scenario_reaches_the_program_and_has_no_name_that_could_be_left_behind(
    pretend, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    pretend(
        """
        say(f"frame {sum(1 for _ in open(sys.argv[1]))} 0 0 - other")
        heard()
        """
    )
    events = air.events(ONE)
    assert next(events) == air.Frame(len(ONE.text().splitlines()), 0.0, 0, None, "other")
    assert list(folder.iterdir()) == []
    events.close()


def test_a_program_that_is_not_listened_to_any_more_is_ended(pretend) -> None:
    pretend("while True: say('frame 0.1 0.2 3 - other')")
    events = air.events(ONE)
    assert next(events) == air.Frame(0.1, 0.2, 3, None, "other")
    events.close()


def test_where_the_program_is_not_built_that_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sysconfig, "get_path", lambda _: str(tmp_path))
    monkeypatch.setenv("PATH", str(tmp_path))
    assert main(["simulate", str(tmp_path / "walk"), "--modules"]) == 2
    assert "synchronizar-air: is not there: it comes with the package" in capsys.readouterr().err


# What modules measure


@needs_air
@pytest.mark.parametrize("scheme", SCHEMES)
def test_ranges_are_true_to_a_centimetre_where_stamps_have_no_noise(scheme: str) -> None:
    scene = replace(PRECISE, bias_sigma=0.1, clock_offset_sigma=0.2, antennas=1, static_radios=1)
    simulation = simulate_modules(scene, scheme).simulation
    ranges = simulation.recording.ranges
    bias = np.array([simulation.range_bias[user.name] for user in simulation.recording.users])
    off = simulation.range_errors() - bias[ranges.a] - bias[ranges.b]
    assert len(off) > 20
    assert abs(off.mean()) < 0.01
    assert off.std() < 0.01
    assert np.abs(off).max() < 0.05, "powers that are a little wrong make their correction a little wrong"


@needs_air
@pytest.mark.parametrize("scheme", ["one-to-n", "all-pairs"])
def test_the_noise_of_ranges_is_that_of_the_scene(scheme: str) -> None:
    off = simulate_modules(replace(WALK, sigma=0.05), scheme).simulation.range_errors()
    assert abs(off.mean()) < 0.01
    # Between equal replies, as RANGE_OF_STAMP has it, and where one of the two takes no time.
    assert 0.97 < off.std() / 0.05 < np.sqrt(8.0 / 6.0)


@needs_air
@pytest.mark.parametrize("scheme", ["one-to-n", "all-pairs"])
def test_the_noise_of_ranges_with_equal_replies_is_that_of_the_scene(scheme: str) -> None:
    """Of two modules, whose slots follow one another."""
    off = simulate_modules(replace(WALK, users=2, seconds=8.0, sigma=0.05), scheme).simulation.range_errors()
    assert off.std() == pytest.approx(0.05, rel=0.03)


@needs_air
def test_late_signals_are_too_long_by_what_the_air_put_in_and_hinted_at() -> None:
    simulation = simulate_modules(replace(PRECISE, late_share=0.4, seconds=8.0), "one-to-n").simulation
    off, late, nlos = simulation.range_errors(), simulation.late, simulation.recording.ranges.nlos
    assert 0.1 < late.mean() < 0.8
    # A range in whose middle a burst begins or ends has a part of the detour.
    rest = np.abs(off - simulation.extra)
    assert np.mean(rest[late] < 0.02) > 0.98
    assert np.mean(rest[~late] < 0.02) > 0.98
    assert np.mean(nlos[late] == 1.0) > 0.5
    assert np.mean(nlos[~late] == 1.0) < 0.02


def test_bursts_are_told_as_they_are_drawn() -> None:
    scene = Scene(users=3, seconds=20.0, late_share=0.4)
    blockage = modules.blockage_of(np.random.default_rng(1), scene)
    spans = blockage.spans()
    t = np.random.default_rng(2).uniform(0.0, scene.seconds, 500)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        within = (spans.a == a) & (spans.b == b) & (spans.begin <= t[:, None]) & (t[:, None] < spans.end)
        ends = np.full(len(t), a, dtype=np.int32), np.full(len(t), b, dtype=np.int32)
        np.testing.assert_array_equal(blockage.at(t, *ends), (within * spans.extra).sum(axis=1))
    assert (spans.end - spans.begin).mean() == pytest.approx(scene.late_burst_s, rel=0.5)
    assert spans.extra.min() >= 0.3


def test_crystals_are_each_off_by_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[Scenario] = []

    def stop(scenario: Scenario, *_: object) -> None:
        told.append(scenario)
        raise InputError("air", "stands still")

    monkeypatch.setattr(modules, "collect", stop)
    with pytest.raises(InputError):
        simulate_modules(replace(WALK, users=10), "one-to-n")
    ppm = np.array([[module.ppm, module.board_ppm] for module in told[0].modules])
    assert len(np.unique(ppm)) == 20
    assert np.abs(ppm).max() <= CRYSTAL_PPM == 20.0
    assert np.ptp(ppm, axis=0).min() > CRYSTAL_PPM


def test_how_late_stamps_are_is_told_by_the_datagrams_whose_truth_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    def some_events(*_: object) -> Iterator[air.Datagram]:
        for i, (delay, measured) in enumerate(((0.004, 1.0), (0.003, float("nan")), (0.003, 3.0), (0.007, 4.0))):
            said = RangesDatagram(3, 0, i, 13, 10**9 * i, 0, some_ranges([1], [1000]))
            yield air.Datagram(1.0 + i + delay, encode_ranges(said, reporter_key(bytes(32), 3, 0)), measured)

    monkeypatch.setattr(collect, "events", some_events)
    collected = collect.collect(ONE, simulate(Scene(users=2)).recording.users)
    # The line below all goes through the second and the third.
    np.testing.assert_allclose(collected.ranges.t, [1.003, 2.003, 3.003, 4.003], atol=1e-9)
    assert collected.behind == pytest.approx(0.003, abs=1e-9)


@needs_air
@pytest.mark.parametrize("name", MOST_M)
def test_what_is_not_refused_the_air_takes(name: str) -> None:
    heard = simulate_modules(replace(WALK, users=5, seconds=1.0, late_share=0.5, **{name: MOST_M[name]}), "one-to-n")
    assert len(heard.simulation.recording.users) == 5


@needs_air
def test_stamps_stay_equally_late_while_the_network_s_clock_drifts() -> None:
    """The coordinator's crystal is 15 ppm fast, its clock 27 ms ahead after half an hour."""
    fast, slow = (Module(ppm, ppm, on, np.zeros(1), HERE + x) for ppm, on, x in ((15.0, 0.0, 0.0), (-15.0, 0.1, 2.0)))
    scenario = replace(ONE, seconds=1800.0, scheme="polling", modules=[fast, slow])
    receiver, told, arrived, measured, newest = Receiver(scenario.keys()), [], [], [], []
    live: dict[int, float] = {}
    for event in air.events(scenario):
        assert isinstance(event, air.Datagram)
        taken = receiver.take(event.payload, event.t)
        assert taken is not None
        live |= {one.datagram.sequence: float(one.t.max()) for one in taken.stamped}
        if len((said := taken.datagram).ranges):
            told.append(said)
            arrived.append(event.t)
            measured.append(event.measured)
            newest.append(1e-9 * said.time_ns + 1e-6 * said.ranges["offset_us"].max())
    ahead = np.array(newest) - np.array(measured)
    assert ahead[-1] - ahead[0] == pytest.approx(15e-6 * (measured[-1] - measured[0]), rel=0.01)
    behind = np.array([one.t.max() for one in stamp_all(told, arrived)]) - np.array(measured)
    assert 0.0 < behind.mean() < 0.05
    assert np.ptp(behind) < 1e-3
    assert list(live) == [said.sequence for said in told], "as they came, each once"
    as_they_came = np.array(list(live.values())) - np.array(measured)
    assert np.abs(as_they_came - behind.mean()).max() < 3e-3
    assert np.abs(as_they_came - behind.mean())[100:].max() < 1e-3


@needs_air
def test_people_walk_as_they_do_without_modules() -> None:
    scene = replace(WALK, late_joiners=1, static_radios=1, drift_m_per_sqrt_s=0.02)
    plain, ranged = simulate(scene), simulate_modules(scene, "one-to-n").simulation
    assert ranged.recording.users == plain.recording.users
    for name, track in plain.recording.tracks.items():
        np.testing.assert_array_equal(ranged.recording.tracks[name].position, track.position)
        np.testing.assert_array_equal(ranged.truth[name].position, plain.truth[name].position)


@needs_air
def test_everybody_ranges_to_everybody_but_radios_to_each_other() -> None:
    heard = simulate_modules(replace(WALK, users=2, static_radios=2), "all-pairs")
    assert pairs(heard) == {(0, 1), (0, 2), (0, 3), (1, 2), (1, 3)}


@needs_air
def test_one_to_n_ranges_hundreds_of_times_a_second_and_overhears_the_others() -> None:
    heard = simulate_modules(WALK, "one-to-n")
    ranges = heard.simulation.recording.ranges
    assert pairs(heard) == {(0, 1), (0, 2), (1, 2)}
    steady = ranges.t > 1.0
    assert steady.sum() / 3.0 / 3.0 == pytest.approx(250.0, rel=0.05)
    assert {SOURCES[source] for source in np.unique(ranges.source).tolist()} == {"module", "overheard"}
    assert heard.dropped == 0
    assert heard.frames == []


@needs_air
def test_lost_frames_cost_ranges() -> None:
    whole, lossy = (simulate_modules(replace(WALK, loss=loss), "all-pairs").simulation for loss in (0.0, 0.3))
    kept = len(lossy.recording.ranges) / len(whole.recording.ranges)
    assert 0.5 < kept < 0.8
    assert len(simulate_modules(replace(WALK, loss=1.0), "all-pairs").simulation.recording.ranges) == 0


@needs_air
def test_a_late_joiner_ranges_once_it_is_there() -> None:
    simulation = simulate_modules(replace(WALK, late_joiners=1), "one-to-n").simulation
    ranges = simulation.recording.ranges
    of_joiner = (ranges.a == 2) | (ranges.b == 2)
    assert 2.0 < ranges.t[of_joiner].min() < 3.0
    assert ranges.t[~of_joiner].min() < 1.0


@needs_air
def test_frames_do_not_overlap_once_there_is_a_network() -> None:
    frames = [f for f in simulate_modules(WALK, "one-to-n", frames=True).frames if f.begin > 1.0]
    assert {f.kind for f in frames} == {"word"}
    begin, end = np.array([[f.begin, f.end] for f in frames]).T
    assert (begin[1:] > end[:-1]).all()
    assert np.median(np.diff(begin)) == pytest.approx(1e-3, rel=0.01)


# The whole chain


@needs_air
def test_the_same_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "two"):
        scene = replace(WALK, seconds=2.0, late_share=0.3, loss=0.1, static_radios=1)
        simulate_modules(scene, "one-to-n").simulation.save(tmp_path / name)
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*") if p.is_file())
    assert len(files) == 3 + 4 + 3, "tracks, truth, and ranges.csv, truth/ranges.csv, recording.toml"
    for file in files:
        assert (tmp_path / "one" / file).read_bytes() == (tmp_path / "two" / file).read_bytes()


@needs_air
def test_what_modules_tell_comes_through_the_file(tmp_path: Path) -> None:
    simulation = simulate_modules(replace(WALK, late_share=0.3), "one-to-n").simulation
    simulation.save(tmp_path)
    told, read = simulation.recording.ranges, Recording.load(tmp_path).ranges
    header = (tmp_path / "ranges.csv").read_text().splitlines()[0].split(",")
    assert {"rx_power", "fp_power", "nlos", "source"} <= set(header)
    assert np.isfinite(read.rx_power).mean() > 0.99
    weaker = read.rx_power - read.fp_power
    assert 0.0 < np.nanmedian(weaker[~simulation.late]) < 6.0
    assert np.nanmedian(weaker[simulation.late]) > 10.0
    for column in ("t", "distance", "sigma", "rx_power", "fp_power", "nlos", "source"):
        np.testing.assert_array_equal(getattr(read, column), getattr(told, column))


@needs_air
def test_a_walk_with_modules_is_registered_and_evaluated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    walk, answer = tmp_path / "walk", tmp_path / "answer"
    options = ["--users", "3", "--seconds", "8", "--sigma", "0.03", "--late-share", "0.1", "--scheme", "all-pairs"]
    assert main(["simulate", *options, "--modules", str(walk)]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert said.out.startswith(f"{walk}: 3 users, ")
    assert said.out.rstrip().endswith(" datagrams, 0 ranges dropped")
    assert main(["register", str(walk), "--out", str(answer), "--json"]) == 0
    users = json.loads(capsys.readouterr().out)["users"]
    assert [user["state"] for user in users.values()] == ["registered"] * 3
    assert main(["evaluate", str(walk), str(answer), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["joint_ate_xy"] < 0.05


def test_as_many_modules_are_let_into_a_network_as_the_firmware_takes() -> None:
    header = (REPOSITORY / "firmware" / "core" / "frame.h").read_text()
    found = re.search(r"#define FRAME_MEMBERS (\d+)", header)
    assert found is not None
    assert int(found[1]) == MOST_MODULES
