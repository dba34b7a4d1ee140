#!/usr/bin/env bash
# The firmware's tests beyond the host's own build: under sanitizers, on a board's processor, fuzzed. Builds stand in build/.
# firmware/tests/run.sh [sanitized] [riscv] [fuzz]: these, one after another; all where none is named.
set -euo pipefail
cd "$(dirname "$0")/../.."

tested() {  # name of the build, then what CMake is told
  local build=build/$1
  shift
  echo "== firmware, $(basename "$build")"
  cmake -S firmware -B "$build" -G Ninja -DCMAKE_COMPILE_WARNING_AS_ERROR="${CI:-OFF}" "$@" > /dev/null
  cmake --build "$build" -- --quiet
  ctest --test-dir "$build" --output-on-failure --parallel 2 --timeout 300 --no-tests=error
}

sanitized() {
  tested sanitized -DCORE_TESTS=ON -DLIFE_HOURS=0.05 -DCMAKE_BUILD_TYPE=Debug \
    -DCMAKE_C_FLAGS="-O1 -fsanitize=address,undefined -fno-sanitize-recover=all" \
    -DCMAKE_CXX_FLAGS="-O1 -fsanitize=address,undefined -fno-sanitize-recover=all"
}

riscv() {
  if tools/have.sh riscv; then
    tested riscv -DCORE_TESTS=ON --toolchain tests/riscv.cmake
  fi
}

fuzz() {
  if tools/have.sh fuzz; then
    tested fuzz -DFIRMWARE_FUZZ=ON -DFUZZ_SECONDS="${FUZZ_SECONDS:-5}" -DCMAKE_C_COMPILER=clang \
      -DCMAKE_BUILD_TYPE=Debug -DCMAKE_C_FLAGS="-O1 -fsanitize=fuzzer-no-link,address,undefined -fno-sanitize-recover=all"
  fi
}

[ $# -gt 0 ] || set -- sanitized riscv fuzz
for named in "$@"; do
  "$named"
done
