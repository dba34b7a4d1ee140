"""The ESP-IDF target, as far as it can be checked without ESP-IDF: see firmware/targets/esp-idf/README.md."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.paths import REPOSITORY

TARGET = REPOSITORY / "firmware/targets/esp-idf"
MAIN, STUBS = TARGET / "main", TARGET / "stubs"
CORE = REPOSITORY / "firmware/core"
SOURCES = sorted(MAIN.glob("*.c"))
WARNINGS = ["-std=gnu17", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow"]
WARNINGS += ["-Wstrict-prototypes", "-Wmissing-prototypes", "-Werror"]

# The second has integers as the ESP32 has: pointers of 32 bits, and an int32_t that is a long.
COMPILERS = {
    "host": ["cc"],
    "32 bits": ["riscv64-unknown-elf-gcc", "--specs=picolibc.specs", "-march=rv32imc", "-mabi=ilp32"],
}
SETTINGS = {
    "default": [],
    "battery, no button": ["-DCONFIG_SYNCHRONIZAR_BATTERY=1", "-DCONFIG_SYNCHRONIZAR_BUTTON_GPIO=-1"],
}


def run(*command: object) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("settings", SETTINGS)
def test_sources_compile_against_the_stubs_without_a_warning(compiler: str, settings: str) -> None:
    if not shutil.which(COMPILERS[compiler][0]):
        pytest.skip(f"no {COMPILERS[compiler][0]}")
    folders = [f"-I{folder}" for folder in (STUBS, MAIN, CORE)]
    run(*COMPILERS[compiler], *WARNINGS, *SETTINGS[settings], "-fsyntax-only", *folders, *SOURCES)


@pytest.mark.parametrize("gpio", range(40))
def test_a_button_that_cannot_wake_the_board_stops_the_build(gpio: int) -> None:
    setting = f"-DCONFIG_SYNCHRONIZAR_BUTTON_GPIO={gpio}"
    words = ["cc", *WARNINGS, setting, "-fsyntax-only", f"-I{STUBS}", f"-I{MAIN}", str(MAIN / "power.c")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    # Pins with an RTC function: ESP32 datasheet, table "RTC_MUX pin summary".
    wakes = gpio in {0, 2, 4, 12, 13, 14, 15, 25, 26, 27} or gpio >= 32
    assert (done.returncode == 0) == wakes
    assert wakes or "cannot wake the ESP32" in done.stderr


# With sources of the core that they call, and whether ESP-IDF is pretended.
BEHAVING = {"command": (["calibration.c"], False), "hal_esp": ([], True), "network": ([], True)}


@pytest.mark.parametrize("name", BEHAVING)
def test_what_does_not_need_the_board_behaves(name: str, tmp_path: Path) -> None:
    program = tmp_path / name
    needed, pretended = BEHAVING[name]
    folders = [REPOSITORY, *([STUBS] if pretended else []), MAIN, CORE]
    includes = [f"-I{folder}" for folder in folders]
    sources = [TARGET / f"tests/test_{name}.c", MAIN / f"{name}.c", *(CORE / file for file in needed)]
    run("cc", *WARNINGS, "-g", "-fsanitize=address,undefined", *includes, *sources, "-lm", "-o", program)
    run(program)


def test_the_build_takes_every_source_and_the_core() -> None:
    listed = re.search(r"SRCS ([^\n]*)", (MAIN / "CMakeLists.txt").read_text())
    assert listed is not None
    assert sorted(listed[1].split()) == [source.name for source in SOURCES]
    component = TARGET / "components/synchronizar_core"
    named = set(re.findall(r'"(\.\.[^"]*)"', (component / "CMakeLists.txt").read_text()))
    assert {(component / folder).resolve() for folder in named} == {CORE}


def used_settings() -> set[str]:
    text = "".join(file.read_text() for file in [*SOURCES, *MAIN.glob("*.h")])
    return set(re.findall(r"CONFIG_(SYNCHRONIZAR_\w+)", text))


def test_the_stubs_settings_are_the_defaults_of_kconfig() -> None:
    kconfiglib = pytest.importorskip("esp_kconfiglib")
    kconfig = kconfiglib.Kconfig(str(MAIN / "Kconfig.projbuild"))
    kconfig.syms["SYNCHRONIZAR_BATTERY"].set_value("y")
    defaults = {s.name: s.str_value for s in kconfig.unique_defined_syms if s.str_value not in ("y", "n")}
    stub = dict(re.findall(r"#define CONFIG_(SYNCHRONIZAR_\w+) (-?\d+)", (STUBS / "sdkconfig.h").read_text()))
    assert stub == defaults
    assert used_settings() == {*defaults, "SYNCHRONIZAR_BATTERY"}


def test_only_what_the_radio_has_can_be_chosen() -> None:
    kconfiglib = pytest.importorskip("esp_kconfiglib")
    kconfig = kconfiglib.Kconfig(str(MAIN / "Kconfig.projbuild"))
    chosen: dict[str, list[int]] = {"CHANNEL": [], "PRF_MHZ": [], "SCHEME": []}
    for number, values in chosen.items():
        choice = f"SYNCHRONIZAR_{number.removesuffix('_MHZ')}_CHOICE"
        for option in kconfig.named_choices[choice].syms:
            option.set_value("y")
            values.append(int(kconfig.syms[f"SYNCHRONIZAR_{number}"].str_value))
    assert chosen == {"CHANNEL": [1, 2, 3, 4, 5, 7], "PRF_MHZ": [16, 64], "SCHEME": [0, 1, 2]}


def test_kconfig_keeps_to_its_style(tmp_path: Path) -> None:
    pytest.importorskip("kconfcheck")
    shutil.copy(MAIN / "Kconfig.projbuild", tmp_path)
    run(sys.executable, "-m", "kconfcheck", tmp_path / "Kconfig.projbuild")


def test_the_manifest_is_valid_and_asks_for_a_version_of_idf() -> None:
    manager = pytest.importorskip("idf_component_tools.manager")
    manifest = manager.ManifestManager(str(MAIN), "main")
    manifest.validate()
    assert manifest.validation_errors == []
    assert manifest.load().targets == ["esp32"]
    assert manifest.load().dependencies["idf"] == ">=5.2,<6.0"


def test_the_key_is_in_no_text_that_is_printed() -> None:
    for source in SOURCES:
        for call in re.findall(r"(?:ESP_LOG\w|printf)\(.*?\);", source.read_text(), flags=re.DOTALL):
            assert not re.search(r"\b(key|password|line|words)\b", re.sub(r'"[^"]*"', "", call)), call
