"""The compiled core: no floating point, no system call, no exception, no AVX2 for all; and planted ones are caught."""

from __future__ import annotations

import subprocess
from pathlib import Path

import core_binary_gates
import pytest

from ruffini.core import native_folder

CLEAN = "long f(const int* x, int n) { long s = 0; for (int i = 0; i < n; ++i) s += x[i]; return s; }"
FLOATS = {
    "addition": "float f(float x, float y) { return x + y; }",
    "conversion": "int f(double x) { return static_cast<int>(x); }",
    "from integer": "float f(int x) { return static_cast<float>(x); }",
    "comparison": "bool f(double x, double y) { return x < y; }",
}
SYSTEM = {
    "exception": ("int f(int x) { if (x < 0) throw x; return x; }", "__cxa_throw"),
    "file": ("#include <cstdio>\nvoid f() { std::puts(\"\"); }", "puts"),
    "clock": ("#include <ctime>\nlong f() { return time(nullptr); }", "time"),
    "float library": ("#include <cmath>\ndouble f(double x) { return std::sin(x); }", "sin"),
}  # fmt: skip


@pytest.fixture
def core() -> Path:
    return native_folder().parent / "libruffini_core.a"


def compiled(source: str, folder: Path) -> Path:
    (folder / "a.cpp").write_text(source)
    out = folder / "a.o"
    subprocess.run(["g++", "-std=c++20", "-O2", "-fPIC", "-c", str(folder / "a.cpp"), "-o", str(out)], check=True)
    return out


def test_core_has_no_floating_point(core):
    assert core_binary_gates.float_instructions(core) == []


def test_core_asks_nothing_of_the_system(core):
    assert core_binary_gates.foreign_symbols(core) == []


def test_instructions_of_one_processor_are_not_for_all(core):
    assert core_binary_gates.shared_avx2(core) == []


@pytest.mark.parametrize(("name", "n_found"), [("Table", 1), ("Avx2Table", 0)])
def test_planted_instructions_for_all_are_caught(name, n_found, tmp_path):
    source = f"template <typename T> struct {name} {{ static T f(T x); }};\n"
    source += f"template <typename T> T {name}<T>::f(T x) {{ return x + 1; }}\ntemplate struct {name}<int>;"
    planted = compiled(source, tmp_path).rename(tmp_path / "a_avx2.cpp.o")
    assert len(core_binary_gates.shared_avx2(planted)) == n_found


def test_integers_pass(tmp_path):
    clean = compiled(CLEAN, tmp_path)
    assert core_binary_gates.float_instructions(clean) == []
    assert core_binary_gates.foreign_symbols(clean) == []


@pytest.mark.parametrize("source", FLOATS.values(), ids=FLOATS)
def test_planted_float_is_caught(source, tmp_path):
    assert core_binary_gates.float_instructions(compiled(source, tmp_path)) != []


@pytest.mark.parametrize(("source", "symbol"), SYSTEM.values(), ids=SYSTEM)
def test_planted_call_is_caught(source, symbol, tmp_path):
    assert symbol in core_binary_gates.foreign_symbols(compiled(source, tmp_path))
