"""Checks the tests: each known pitfall, put into the core's source, makes those fail that are named beside it.

python firmware/tests/mutations.py BUILD, where BUILD is a build of the repository with CORE_TESTS. Only the changed
file is compiled; all else is linked from there.
"""

import json
import shlex
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

CORE = Path(__file__).parents[1] / "core"
WORKERS = 2
LONGEST_S = 60  # a test that has not ended by then has noticed too


@dataclass(frozen=True)
class Mutation:
    """A pitfall: what it is, the text of a core file that avoids it, the text that does not, and who has to notice."""

    pitfall: str
    file: str
    good: str
    bad: str
    tests: tuple[str, ...]


MUTATIONS = (
    Mutation(
        "no receiver reset after an error",
        "dw1000.c",
        "  put(radio, DW1000_PMSC_SOFTRESET, DW1000_SOFTRESET_RX, 1);\n",
        "",
        ("test_dw1000", "test_ranges"),
    ),
    Mutation(
        "the LDE's microcode is not loaded", "dw1000.c", "  load_lde(radio);\n", "", ("test_dw1000", "test_ranges")
    ),
    Mutation(
        "the low nine bits stay in the stamp of a delayed frame",
        "dw1000.c",
        "return ticks_after(at & ~DX_IGNORED, tx_delay(radio));",
        "return ticks_after(at, tx_delay(radio));",
        ("test_dw1000", "test_ranges"),
    ),
    Mutation(
        "TX_ANTD is not written again after sleep",
        "dw1000.c",
        "  put(radio, DW1000_EUI, settings->eui64, 8);\n  write_antenna_delay(radio);\n",
        "  put(radio, DW1000_EUI, settings->eui64, 8);\n",
        ("test_dw1000", "test_driver"),
    ),
    Mutation(
        "stamps are cut to 32 bits",
        "dw1000.c",
        "event->stamp = bytes_get(time, STAMP_SIZE);",
        "event->stamp = bytes_get(time, 4);",
        ("test_dw1000", "test_ranges"),
    ),
    Mutation(
        "the bias by power has the wrong sign",
        "node.c",
        "rounded_mm(result->distance_um - bias_um)",
        "rounded_mm(result->distance_um + bias_um)",
        ("test_ranges",),
    ),
    Mutation(
        "a frame that is too late is taken for sent",
        "dw1000.c",
        "(DW1000_HPDWARN | DW1000_TXPUTE)",
        "DW1000_TXPUTE",
        ("test_dw1000", "test_driver"),
    ),
    Mutation(
        "the SPI is fast before the PLL has locked",
        "dw1000.c",
        "  spi_fast(radio, false);\n  if (!found_after_reset(radio))",
        "  spi_fast(radio, true);\n  if (!found_after_reset(radio))",
        ("test_dw1000", "test_ranges"),
    ),
    Mutation(
        "the antenna delay's temperature has the wrong sign",
        "calibration.c",
        "temperature_cc - calibration->temperature_cc",
        "calibration->temperature_cc - temperature_cc",
        ("test_calibration", "test_ranges"),
    ),
    Mutation(
        "what is below a tick is lost",
        "twr.c",
        "ticks * TWR_FRACTION + divide(rest * TWR_FRACTION, sum)",
        "ticks * TWR_FRACTION",
        ("test_twr", "test_ranges"),
    ),
    Mutation(
        "devices that touch have no distance",
        "twr.c",
        "ticks < shortest_flight",
        "ticks < 0",
        ("test_twr", "test_ranges"),
    ),
    Mutation(
        "a stamp of an older frame is taken for the latest one's",
        "exchange.c",
        " && word->stamp[us].sequence == exchange->sequence",
        "",
        ("test_exchange",),
    ),
    Mutation(
        "a datagram played again is taken", "wire.c", "(window->taken >> behind & 1) != 0", "false", ("test_wire",)
    ),
    Mutation(
        "the window of sequences is one too short",
        "wire.c",
        "if (behind >= 64 ||",
        "if (behind >= 63 ||",
        ("test_wire",),
    ),
    Mutation(
        "anybody's orders are followed",
        "wire.c",
        "size != WIRE_ORDER_SIZE || !has_tag(bytes, size, key)",
        "size != WIRE_ORDER_SIZE",
        ("test_wire",),
    ),
    Mutation(
        "old ranges are sent for ever",
        "outbox.c",
        "now_us > waiting(outbox, 0)->at_us + OUTBOX_TOO_OLD_US",
        "false",
        ("test_outbox",),
    ),
    Mutation(
        "an order from before a restart is followed",
        "node.c",
        "order->sequence >> 32 == node->settings.restarts && ",
        "",
        ("test_network",),
    ),
    Mutation(
        "a clock that begins anew has its old name",
        "node.c",
        "      .epochs = node->ranging.settings.epochs,\n",
        "",
        ("test_network",),
    ),
    Mutation(
        "two halves of a network go on by one clock",
        "ranging.c",
        "  if (silent) begin_epoch(r);\n",
        "  (void)silent;\n",
        ("test_network",),
    ),
    Mutation(
        "somebody leaves without having said so",
        "ranging.c",
        "  if (r->last_word) leave_now(r);",
        "  if (r->leaving) leave_now(r);",
        ("test_network",),
    ),
)


class Build:
    """What a finished build has: how each file was compiled, and to what."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        entries = json.loads((self.folder / "compile_commands.json").read_text())
        self.entry = {Path(entry["file"]).name: entry for entry in entries if "/firmware/" in entry["file"]}
        self.archives = [str(path) for path in sorted(self.folder.glob("firmware/*.a"))]

    def compile(self, source: Path, target: Path) -> None:
        """Compile a changed file of the core as the build compiled the good one."""
        entry = self.entry[source.name]
        command = shlex.split(entry["command"])
        command[command.index("-o") + 1] = str(target)
        command[command.index(entry["file"])] = str(source)
        subprocess.run([*command, "-w"], cwd=entry["directory"], check=True)

    def link(self, test: str, changed: Path, target: Path) -> None:
        """Link a test with a changed object, which comes before the archive with the good one."""
        entry = self.entry.get(f"{test}.cpp") or self.entry[f"{test}.c"]
        compiler = shlex.split(self.entry["events.cpp"]["command"])[0]
        tested = self.folder / entry["output"]
        command = [compiler, str(tested), str(changed), *self.archives, *self.archives, "-o", str(target)]
        subprocess.run(command, check=True)

    def passes(self, program: Path) -> bool:
        """Run a test."""
        try:
            run = subprocess.run([program], cwd=self.folder / "firmware", capture_output=True, timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            return False
        return run.returncode == 0


def mutated(mutation: Mutation) -> str:
    """Return the file's source with the pitfall in it."""
    source = (CORE / mutation.file).read_text()
    if (count := source.count(mutation.good)) != 1:
        raise SystemExit(f"{mutation.pitfall}: {mutation.file} has {count} times\n{mutation.good}")
    return source.replace(mutation.good, mutation.bad)


def unnoticed_by(build: Build, mutation: Mutation) -> list[str]:
    """Return the named tests that pass with the pitfall."""
    with tempfile.TemporaryDirectory() as folder:
        source, changed, program = Path(folder, mutation.file), Path(folder, "changed.o"), Path(folder, "test")
        source.write_text(mutated(mutation), encoding="utf-8")
        build.compile(source, changed)
        passing = []
        for test in mutation.tests:
            build.link(test, changed, program)
            if build.passes(program):
                passing.append(test)
        return passing


def main() -> None:
    """Try all; the exit code tells whether each was noticed."""
    build = Build(Path(sys.argv[1]))
    tests = sorted({test for mutation in MUTATIONS for test in mutation.tests})
    with ThreadPoolExecutor(WORKERS) as pool:
        passed = list(pool.map(build.passes, [build.folder / "firmware" / test for test in tests]))
        if failed := [test for test, passes in zip(tests, passed, strict=True) if not passes]:
            raise SystemExit(f"without any mutation there fails: {' '.join(failed)}")
        unnoticed = list(pool.map(partial(unnoticed_by, build), MUTATIONS))
    for mutation, by in zip(MUTATIONS, unnoticed, strict=True):
        verdict = f"NOT NOTICED by {' '.join(by)}" if by else f"noticed by {' '.join(mutation.tests)}"
        print(f"{mutation.pitfall}: {verdict}")
    raise SystemExit(1 if any(unnoticed) else 0)


if __name__ == "__main__":
    main()
