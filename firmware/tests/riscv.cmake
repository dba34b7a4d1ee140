# Toolchain of a 32-bit processor like the ESP32-C3's, without an operating system. What is built runs in qemu, whose semihosting
# takes its output and its exit code.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR riscv32)
set(CMAKE_C_COMPILER riscv64-unknown-elf-gcc)
set(CMAKE_C_FLAGS_INIT "--specs=picolibc.specs -march=rv32imc -mabi=ilp32")
# Memory of qemu's board "virt" begins at 0x80000000; the program and its data get 4 MiB each.
set(CMAKE_EXE_LINKER_FLAGS_INIT
    "--crt0=semihost --oslib=semihost -Wl,--defsym=__flash=0x80000000,--defsym=__flash_size=4M,--defsym=__ram=0x80400000,--defsym=__ram_size=4M"
)
set(CMAKE_CROSSCOMPILING_EMULATOR
    qemu-system-riscv32 -M virt -bios none -nographic -monitor none -serial none -semihosting-config
    enable=on,target=native -kernel)
