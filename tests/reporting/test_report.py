from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.live import browser
from synchronizar.cli import main
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.updates import Replay
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import write_registration, write_replay
from synchronizar.reporting.history import history_of
from synchronizar.reporting.report import values as report_numbers
from synchronizar.reporting.report import write_report
from synchronizar.reporting.report.file import PAGE, SCRIPTS, report_html
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

EVIL = "</script><b>&amp;"


@pytest.fixture(scope="module")
def recording() -> Recording:
    scene = Scene(users=3, seconds=12.0, jumps=1, late_share=0.3, static_radios=1, seed=3, clock_offset_sigma=0.05)
    return simulate(scene).recording


@pytest.fixture(scope="module")
def answer(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "answer"
    write_registration(register(recording), recording, folder)
    return folder


@pytest.fixture(scope="module")
def replayed(recording: Recording) -> Replay:
    return replay(recording)


@pytest.fixture(scope="module")
def live(recording: Recording, replayed: Replay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report") / "live"
    write_replay(replayed, recording, folder)
    return folder


@pytest.fixture(scope="module")
def page(recording: Recording, answer: Path) -> Path:
    return write_report(recording, answer, "walk")


@pytest.fixture(scope="module")
def values(page: Path) -> dict[str, Any]:
    return values_in(page.read_text(encoding="utf-8"))


def values_in(text: str) -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    return dict(json.loads(found[1]))


def lines_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "ranges.csv").open(newline="") as file:
        return list(csv.DictReader(file))


# What is in the file


def test_a_pair_has_the_figures_of_the_lines_that_register_wrote(values: dict[str, Any], answer: Path) -> None:
    names, written = [user["name"] for user in values["users"]], lines_of(answer)
    assert len(values["pairs"]) == len({frozenset((line["a"], line["b"])) for line in written})
    for pair in values["pairs"]:
        lines = [line for line in written if {line["a"], line["b"]} == {names[pair["a"]], names[pair["b"]]}]
        residuals = [float(line["residual"]) for line in lines if line["verdict"] == "used"]
        assert pair["used"] == len(residuals)
        assert pair["rejected"] == sum(line["verdict"] == "rejected" for line in lines)
        assert pair["unusable"] == sum(line["verdict"] == "unusable" for line in lines)
        assert pair["rms"] == pytest.approx((sum(r * r for r in residuals) / len(residuals)) ** 0.5, abs=1e-4)
        assert pair["mean"] == pytest.approx(sum(residuals) / len(residuals), abs=1e-4)
        assert abs(pair["worst"]) == pytest.approx(max(map(abs, residuals)), abs=1e-4)


def test_ranges_stand_in_the_order_of_time_to_a_millimetre(values: dict[str, Any], answer: Path) -> None:
    written = sorted(lines_of(answer), key=lambda line: float(line["t"]))
    ranges, began = values["ranges"], min(float(line["t"]) for line in written)
    np.testing.assert_allclose(ranges["t"], [1e3 * (float(line["t"]) - began) for line in written], atol=0.51)
    np.testing.assert_allclose(ranges["distance"], [1e3 * float(line["range"]) for line in written], atol=0.51)
    told = [None if line["residual"] == "" else round(1e3 * float(line["residual"])) for line in written]
    assert [r is None for r in ranges["residual"]] == [r is None for r in told]
    words = ("used", "rejected", "unusable")
    assert [words[verdict] for verdict in ranges["verdict"]] == [line["verdict"] for line in written]


def test_tracks_are_those_that_register_wrote_at_the_range_clocks_time(values: dict[str, Any], answer: Path) -> None:
    told = json.loads((answer / "registration.json").read_text())["users"]
    for user in values["users"]:
        written = np.loadtxt(answer / f"{user['name']}.tum", ndmin=2)
        track = user["track"]
        np.testing.assert_allclose(np.transpose([track[axis] for axis in "xyz"]), 1e3 * written[:, 1:4], atol=0.51)
        if not user["static"]:
            t = written[:, 0] - told[user["name"]]["clock_offset"] - values["began"]
            np.testing.assert_allclose(track["t"], 1e3 * t, atol=0.51)


def test_a_jump_stands_where_the_device_was(values: dict[str, Any], answer: Path) -> None:
    told = json.loads((answer / "registration.json").read_text())["users"]
    jumps = [(user["name"], jump) for user in values["users"] for jump in user["jumps"]]
    assert len(jumps) == sum(len(user["jumps"]) for user in told.values()) > 0
    for name, jump in jumps:
        written = np.loadtxt(answer / f"{name}.tum", ndmin=2)
        own = next(j for j in told[name]["jumps"] if j["distance"] == jump["distance"])
        place = written[np.argmin(np.abs(written[:, 0] - own["t"])), 1:4]
        np.testing.assert_allclose(jump["place"], 1e3 * place, atol=0.51)


def test_states_over_time_are_those_of_the_updates(recording: Recording, live: Path, replayed: Replay) -> None:
    values = values_in(write_report(recording, live, "walk").read_text(encoding="utf-8"))
    history = history_of(replayed.updates, recording)
    for user in values["users"]:
        changes = user["history"]["states"]
        for t, state in zip(history.t, history.users[user["name"]].states, strict=True):
            now = [word for since, word in changes if since <= round(1e3 * t)][-1]
            assert values["states"][now] == str(state)
    assert [text for _, text in values["events"]] == [text for _, text in history.events]


def test_a_long_recording_is_thinned_and_its_figures_are_of_all(
    recording: Recording, answer: Path, values: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(report_numbers, "MOST_RANGES", 50)
    monkeypatch.setattr(report_numbers, "MOST_POSES", 100)
    folder = Path(shutil.copytree(answer, tmp_path / "answer"))
    thin = values_in(write_report(recording, folder, "walk").read_text(encoding="utf-8"))
    assert len(thin["ranges"]["t"]) <= 50
    assert thin["every_range"] == -(-len(recording.ranges) // 50)
    assert sum(len(user["track"]["t"]) for user in thin["users"]) <= 100 + len(recording.users)
    assert (thin["pairs"], thin["counts"]) == (values["pairs"], values["counts"])
    for few, all_of in zip(thin["users"], values["users"], strict=True):
        assert few["track"]["t"][-1] == all_of["track"]["t"][-1]


def test_a_name_is_text_and_never_markup(values: dict[str, Any]) -> None:
    text = report_html({**values, "title": EVIL})
    assert EVIL not in text
    assert values_in(text)["title"] == EVIL
    assert "<title>&lt;/script&gt;&lt;b&gt;&amp;amp;</title>" in text


def test_the_file_asks_for_nothing_from_elsewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "default-src 'none'" in text
    assert not re.search(r"<(link|img|iframe|script[^>]* src)", text)
    assert set(re.findall(r"https?://[^\"'\s]*", text)) == {"http://www.w3.org/2000/svg"}


def test_every_module_of_the_page_is_in_the_file_after_those_it_imports_from() -> None:
    assert {file.stem for file in PAGE.glob("*.js")} == set(SCRIPTS)
    for n, name in enumerate(SCRIPTS):
        imported = re.findall(r'from "\./(\w+)\.js";', (PAGE / f"{name}.js").read_text())
        assert set(imported) <= set(SCRIPTS[:n])


def test_plot_html_writes_the_report_alone(
    recording: Recording, answer: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording.save(tmp_path / "walk")
    folder = Path(shutil.copytree(answer, tmp_path / "answer"))
    (folder / "report.html").unlink(missing_ok=True)
    assert main(["plot", "--html", str(tmp_path / "walk"), str(folder)]) == 0
    assert capsys.readouterr().out == f"{folder / 'report.html'}\n"
    assert not (folder / "picture.png").exists()


def test_a_folder_without_an_answer_is_told(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"registration\.json"):
        write_report(recording, tmp_path, "walk")


# What a browser makes of it


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    executable = browser.chromium()
    if executable is None:
        pytest.skip("needs chromium, which is not here (tools/have.sh chromium)")
    playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright (pip install --group test)")
    with playwright.sync_playwright() as running:
        started = running.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        yield started
        started.close()


def opened(chromium: Any, file: Path, width: int = 1000, dark: bool = False) -> tuple[Any, list[str]]:
    viewport = {"width": width, "height": 800}
    page = chromium.new_context(viewport=viewport, color_scheme="dark" if dark else "light").new_page()
    complaints = browser.complaints(page)
    page.goto(file.as_uri())
    page.wait_for_selector("#pairs rect", state="attached", timeout=60_000)
    return page, complaints


def await_text(page: Any, selector: str, text: str) -> None:
    from playwright.sync_api import expect

    expect(page.locator(selector)).to_have_text(text, timeout=30_000)


def test_a_browser_shows_every_device_pair_and_jump_without_complaint(
    chromium: Any, page: Path, values: dict[str, Any]
) -> None:
    shown, complaints = opened(chromium, page)
    assert shown.locator("#users tbody tr").count() == len(values["users"])
    assert shown.locator("#pair-table tbody tr").count() == len(values["pairs"])
    assert shown.locator("#jumps tbody tr").count() == sum(len(user["jumps"]) for user in values["users"])
    assert sorted(shown.locator("#map .name").all_text_contents()) == [user["name"] for user in values["users"]]
    assert complaints == []


def test_a_range_tells_its_figures_by_the_keyboard(chromium: Any, page: Path, answer: Path) -> None:
    shown, complaints = opened(chromium, page)
    shown.locator("#map").focus()
    shown.keyboard.press("n")
    told = shown.locator("#tip").inner_text()
    found = re.match(r"(\S+) – (\S+) at ([\d.]+) s: (\w+)\nmeasured ([\d.]+) m", told)
    assert found, told
    first = min(float(line["t"]) for line in lines_of(answer))
    assert any(
        {line["a"], line["b"]} == {found[1], found[2]}
        and abs(float(line["t"]) - first - float(found[3])) < 0.006
        and abs(float(line["range"]) - float(found[5])) < 6e-4
        and line["verdict"] == found[4]
        for line in lines_of(answer)
    )
    shown.keyboard.press("Escape")
    assert shown.locator("#tip").is_hidden()
    assert complaints == []


def test_a_pair_and_a_jump_tell_their_figures(chromium: Any, page: Path, values: dict[str, Any]) -> None:
    shown, complaints = opened(chromium, page)
    shown.locator("#pairs").focus()
    pair = next(pair for pair in values["pairs"] if {pair["a"], pair["b"]} == {0, 1})
    assert f"{pair['used']} used, {pair['rejected']} rejected" in shown.locator("#tip").inner_text()
    shown.keyboard.press("Enter")
    await_text(shown, "#residuals-title", "Measured minus predicted over time (m): phone0 – phone1")
    shown.locator("#clear").click()
    shown.locator("#jumps button").first.click()
    jumps = sorted((jump for user in values["users"] for jump in user["jumps"]), key=lambda jump: jump["t"])
    assert f"by {jumps[0]['distance']:.2f} m" in shown.locator("#tip").inner_text()
    await_text(shown, "#now", f"{jumps[0]['t'] / 1e3:.1f} s")
    assert complaints == []


def test_the_slider_moves_everybody(chromium: Any, page: Path) -> None:
    shown, _ = opened(chromium, page)
    before = shown.locator("#map circle").first.get_attribute("cx")
    shown.locator("#time").focus()
    shown.keyboard.press("Home")
    await_text(shown, "#now", "0.0 s")
    assert shown.locator("#map circle").first.get_attribute("cx") != before


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_wider_than_the_page(chromium: Any, page: Path, width: int) -> None:
    shown, _ = opened(chromium, page, width)
    assert shown.evaluate("document.documentElement.scrollWidth") <= width


@pytest.mark.parametrize("of", ["answer", "live"])
def test_print_is_dark_on_white_without_controls_and_no_wider_than_a_sheet(
    chromium: Any, recording: Recording, of: str, request: pytest.FixtureRequest
) -> None:
    shown, _ = opened(chromium, write_report(recording, request.getfixturevalue(of), "walk"), 720, dark=True)
    assert shown.evaluate("getComputedStyle(document.body).backgroundColor") != "rgb(255, 255, 255)"
    shown.emulate_media(media="print")
    assert shown.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert shown.locator(".controls").is_hidden()
    assert shown.evaluate("document.documentElement.scrollWidth") <= 720


def test_a_replay_shows_states_over_time(chromium: Any, recording: Recording, live: Path) -> None:
    shown, complaints = opened(chromium, write_report(recording, live, "walk"))
    assert shown.locator("#lanes-title").inner_text() == "States over time"
    assert shown.locator("#lanes .progress").count() == len(recording.users)
    assert shown.locator("#sigma").is_visible()
    assert shown.locator("#events li").count() > 0
    assert complaints == []


def test_an_answer_without_any_range_is_shown(chromium: Any, recording: Recording, tmp_path: Path) -> None:
    nobody = np.zeros(len(recording.ranges), dtype=bool)
    silent = replace(recording, ranges=recording.ranges.select(nobody))
    write_registration(register(silent), silent, tmp_path)
    _, complaints = opened(chromium, write_report(silent, tmp_path, "walk"))
    assert complaints == []


# How it looks


def brightness(colour: str) -> float:
    """Relative luminance, by WCAG 2.1."""
    parts = [int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def contrast(colour: str, ground: str) -> float:
    low, high = sorted((brightness(colour), brightness(ground)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_names_can_be_read_and_lines_be_seen(dark: bool) -> None:
    light, _, rest = (PAGE / "report.css").read_text().partition("@media screen")
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", rest if dark else light))
    for name, colour in colours.items():
        least = 4.5 if re.fullmatch(r"u\d|ink|quiet|accent", name) else 2.99 if re.fullmatch(r"r\d", name) else 1.0
        assert contrast(colour, colours["ground"]) >= least, name


# Matrices of Machado, Oliveira and Fernandes (2009) for linear colours: nobody sees red, green or blue.
BLIND = {
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def seen(colour: str, matrix: list[list[float]]) -> np.ndarray:
    parts = np.array([int(colour[n : n + 2], 16) / 255 for n in (1, 3, 5)])
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    blind = np.clip(np.array(matrix) @ linear, 0.0, 1.0)
    # CIE L*a*b*, whose distances are about those that people see.
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ blind
    f = np.cbrt(np.maximum(xyz / [0.9505, 1.0, 1.089], 0.008856))
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("kind", BLIND)
@pytest.mark.parametrize("dark", [False, True])
def test_too_short_is_told_from_too_long_and_states_from_each_other_by_the_colour_blind(kind: str, dark: bool) -> None:
    light, _, rest = (PAGE / "report.css").read_text().partition("@media screen")
    colours = dict(re.findall(r"--(\w+): (#[0-9a-f]{6});", rest if dark else light))
    shades = [seen(colours[f"r{n}"], BLIND[kind]) for n in range(7)]
    for short in (0, 1, 2):
        for long in (4, 5, 6):
            assert np.linalg.norm(shades[short] - shades[long]) > 15.0
    states = [seen(colours[state.value], BLIND[kind]) for state in State]
    for n, one in enumerate(states):
        assert all(np.linalg.norm(one - other) > 10.0 for other in states[:n])
