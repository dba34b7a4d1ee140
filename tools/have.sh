#!/usr/bin/env bash
# tools/have.sh NAME: true where a tool of the tests is there or apt can install it; otherwise says what is missing.
set -euo pipefail

probe_riscv() {
  command -v qemu-system-riscv32 && riscv64-unknown-elf-gcc --specs=picolibc.specs -march=rv32imc -mabi=ilp32 -E -x c /dev/null
}
probe_fuzz() {
  echo 'int LLVMFuzzerTestOneInput(void) { return 0; }' | clang -fsanitize=fuzzer,address,undefined -x c - -o /dev/null
}
probe_chromium() { command -v chromium || command -v google-chrome; }
probe_npm() { command -v npm && [ "$(node --version | cut -dv -f2 | cut -d. -f1)" -ge 20 ]; }
probe_cppcheck() { command -v cppcheck; }
probe_arm() { arm-none-eabi-gcc -include string.h -E -x c /dev/null; }
probe_xtensa() { command -v xtensa-lx106-elf-gcc; }

case ${1:?} in
  # Newer releases have their qemu of RISC-V apart.
  riscv) packages="gcc-riscv64-unknown-elf picolibc-riscv64-unknown-elf $(
    apt-cache show qemu-system-riscv > /dev/null 2>&1 && echo qemu-system-riscv || echo qemu-system-misc)" ;;
  fuzz) packages="clang libclang-rt-dev" ;;
  chromium) packages=chromium ;;
  npm) packages="nodejs npm" ;;
  cppcheck) packages=cppcheck ;;
  arm) packages="gcc-arm-none-eabi libnewlib-arm-none-eabi" ;;
  xtensa) packages=gcc-xtensa-lx106 ;;
  *) echo "no tool is called $1" >&2 && exit 2 ;;
esac

probe() { "probe_$1" > /dev/null 2>&1; }

apt_install() {  # $packages
  command -v apt-get > /dev/null && [ "${APT:-yes}" = yes ] || return 1
  echo "installing $packages (not with APT=no)" >&2
  local as_root=()
  [ "$(id -u)" = 0 ] || as_root=(sudo -n)
  # shellcheck disable=SC2086  # a list of words
  { ${as_root[@]+"${as_root[@]}"} timeout 120 apt-get update && ${as_root[@]+"${as_root[@]}"} env DEBIAN_FRONTEND=noninteractive \
    timeout 600 apt-get install --yes --no-install-recommends $packages; } > /dev/null 2>&1
}

probe "$1" || { apt_install && probe "$1"; } || {
  echo "skipped: what needs $packages, which is not here and could not be installed"
  exit 1
}
