"""Prints what the core takes on each processor: its code, its data, and its deepest stack.

The stack is the deepest path in the compiler's call graph (-fcallgraph-info) from what a target calls. What the board's
own functions (hal.h) and the C library take comes on top of it. The compiler for Xtensa has no C library: its figures
are of the objects alone.
"""

import re
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

CORE = Path(__file__).parents[1] / "core"
# For the compiler without a C library.
STRING_H = """#include <stddef.h>
void *memcpy(void *, const void *, size_t);
void *memmove(void *, const void *, size_t);
void *memset(void *, int, size_t);
int memcmp(const void *, const void *, size_t);
"""
ENTRIES = ("node_start", "node_run", "node_hear")


@dataclass(frozen=True)
class Processor:
    """A processor and the compiler for it; its size tools have the compiler's prefix."""

    name: str
    prefix: str
    flags: tuple[str, ...] = ()


PROCESSORS = (
    Processor(
        "RV32IMC (ESP32-C3)", "riscv64-unknown-elf-", ("--specs=picolibc.specs", "-march=rv32imc", "-mabi=ilp32")
    ),
    Processor("Cortex-M4", "arm-none-eabi-", ("-mcpu=cortex-m4", "-mthumb")),
    Processor(
        "Xtensa LX106 (ESP8266)", "xtensa-lx106-elf-", ("-mlongcalls", "-ffreestanding", "-isystem", "{headers}")
    ),
    Processor("x86-64 (host)", ""),
)


def compiled(processor: Processor, source: Path, into: Path) -> Path:
    """Compile for size; beside the object stands its call graph."""
    target = into / f"{source.stem}.o"
    flags = [flag.format(headers=into) for flag in processor.flags]
    command = [f"{processor.prefix}gcc", *flags, "-std=c11", "-Os", "-fcallgraph-info=su", f"-I{CORE}"]
    subprocess.run([*command, "-c", str(source), "-o", str(target)], check=True)
    return target


def sections(processor: Processor, objects: list[Path]) -> tuple[int, int, int]:
    """Bytes of code and constants, of initialised, and of zeroed data."""
    lines = subprocess.run(
        [f"{processor.prefix}size", *map(str, objects)], check=True, capture_output=True, text=True
    ).stdout.splitlines()[1:]
    text, data, bss = (sum(int(line.split()[i]) for line in lines) for i in range(3))
    return text, data, bss


def size_of_node(processor: Processor, into: Path) -> int:
    """Tell sizeof(struct node), as the size of a symbol."""
    source = into / "node_size.c"
    source.write_text('#include "node.h"\nstruct node node;\n')
    listing = subprocess.run(
        [f"{processor.prefix}nm", "-S", str(compiled(processor, source, into))],
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    return next(int(line.split()[1], 16) for line in listing.splitlines() if line.endswith(" node"))


def deepest_stack(graphs: list[Path]) -> tuple[int, list[str]]:
    """Return the bytes of the deepest path from an entry, and the functions on it."""
    frame: dict[str, int] = {}
    calls: dict[str, set[str]] = defaultdict(set)
    for graph in graphs:
        text = graph.read_text()
        for name, label in re.findall(r'node: \{ title: "([^"]+)" label: "([^"]*)"', text):
            if stack := re.search(r"(\d+) bytes \(([\w,]+)\)", label):
                if stack[2] == "dynamic":
                    raise SystemExit(f"{name} takes a stack without bound")
                frame[name] = int(stack[1])
        for caller, callee in re.findall(r'edge: \{ sourcename: "([^"]+)" targetname: "([^"]+)"', text):
            calls[caller].add(callee)

    def deepest(name: str, path: tuple[str, ...]) -> tuple[int, list[str]]:
        if name in path:
            raise SystemExit(f"{name} calls itself")
        below = max((deepest(callee, (*path, name)) for callee in calls[name]), default=(0, []))
        return frame.get(name, 0) + below[0], [name, *below[1]]

    return max(deepest(entry, ()) for entry in ENTRIES)


def main() -> None:
    """Print the table, for those processors whose compiler is here."""
    print("| processor | code and constants, bytes | data | zeroed | a node (`struct node`) | deepest stack | where |")
    print("|---|---|---|---|---|---|---|")
    for processor in PROCESSORS:
        if shutil.which(f"{processor.prefix}gcc") is None:
            print(f"{processor.name}: {processor.prefix}gcc is not here", file=sys.stderr)
            continue
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "string.h").write_text(STRING_H, encoding="utf-8")
            objects = [compiled(processor, source, Path(folder)) for source in sorted(CORE.glob("*.c"))]
            text, data, bss = sections(processor, objects)
            stack, path = deepest_stack([object.with_suffix(".ci") for object in objects])
            node = size_of_node(processor, Path(folder))
        where = " > ".join(function.rpartition(":")[2] for function in path)  # static ones carry their file's name
        print(f"| {processor.name} | {text} | {data} | {bss} | {node} | {stack} | {where} |")


if __name__ == "__main__":
    main()
