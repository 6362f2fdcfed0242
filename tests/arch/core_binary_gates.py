"""Gates on the compiled core: no floating point, no system call, no exception, every processor its own instructions.

Judged on what the compiler made.
"""

from __future__ import annotations

import platform
import re
import subprocess
from pathlib import Path

# Arithmetic, comparison and conversion of floats; moves and integer vectors are not in here.
FLOAT_INSTRUCTIONS = {
    "x86_64": re.compile(
        r"v?(add|sub|mul|div|sqrt|min|max|cmp\w*|u?comi|round|rcp|rsqrt|hadd|hsub|addsub|dp)(ss|sd|ps|pd)"
        r"|v?cvt\w+|vfn?m(add|sub)\w*|f(ild|ist\w*|add|sub|mul|div|ld|st|sqrt|com)\w*"
    ),
    "aarch64": re.compile(
        r"f(add|sub|n?mul|div|sqrt|n?madd|n?msub|mla|mls|cmp|cmpe|cvt|abs|neg|max|min|rint)\w*|[su]cvtf"
    ),
}
# What the core may ask for from outside: memory, and the ends that a standard container has.
ALLOWED_SYMBOLS = re.compile(
    r"ruffini::.*|operator (new|delete).*|std::__throw_\w+.*|std::(__cxx11::)?(basic_)?string.*"
    r"|mem(cpy|set|move|cmp|chr)|str(len|cmp)|bcmp|abort|__assert_fail|vtable for __cxxabiv1::.*|typeinfo for .*"
    r"|__cxa_(guard_(acquire|release|abort)|atexit|pure_virtual)|__dso_handle|__libc_single_threaded|_GLOBAL_OFFSET_TABLE_"
    r"|__stack_chk_(fail|guard)|__aarch64_\w+|__cpu_(model|indicator_init)|__u?(div|mod)ti3"
)


def float_instructions(archive: Path) -> list[str]:
    """Floating-point instructions of the core, each with its function."""
    pattern = FLOAT_INSTRUCTIONS[platform.machine()]
    text = subprocess.run(
        ["objdump", "-d", "-C", "--no-show-raw-insn", str(archive)], capture_output=True, text=True, check=True
    )
    function, found = "?", []
    for line in text.stdout.splitlines():
        if line.endswith(">:"):
            function = line.split("<", 1)[1][:-2]
        elif (
            (fields := line.split("\t"))
            and len(fields) > 1
            and (word := fields[1].split(" ")[0])
            and pattern.fullmatch(word)
        ):
            found.append(f"{function}: {fields[1].strip()}")
    return found


def foreign_symbols(archive: Path) -> list[str]:
    """Symbols that the core needs from outside and should not: system calls, exceptions, libraries."""
    listed = subprocess.run(
        ["nm", "-C", "--undefined-only", str(archive)], capture_output=True, text=True, check=True
    ).stdout
    names = {line.split(" U ", 1)[1].strip() for line in listed.splitlines() if " U " in line}
    return sorted(name for name in names if not ALLOWED_SYMBOLS.fullmatch(name))


def shared_avx2(archive: Path) -> list[str]:
    """Functions of the files for AVX2 that other files may have under the same name.

    The linker keeps one of them for all: a processor without AVX2 would be given its instructions.
    """
    listed = subprocess.run(
        ["nm", "-A", "-C", "--defined-only", str(archive)], capture_output=True, text=True, check=True
    )
    weak = [line.partition(" W ") for line in listed.stdout.splitlines() if "_avx2.cpp.o:" in line and " W " in line]
    return sorted(name for _, _, name in weak if "avx2" not in name.lower())
