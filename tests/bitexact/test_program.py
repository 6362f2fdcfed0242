"""Programs in the core against the mirror: random shapes, folds, stages and selections, and what is refused."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from mirror.program import Program as Mirror

from ruffini.calibrate.container import pack
from ruffini.core import native_folder
from ruffini.fem.compile import compile_matrix
from ruffini.fem.hierarchy import Shape
from ruffini.fem.program import Panel, Plan, Program, quantise
from ruffini.fem.symmetry import node_sites

I64 = npt.NDArray[np.int64]
METADATA = {"format": "ruffini-calibration", "format_version": "1", "product": "ruffini"}


class Refused(Exception):
    pass


def run_core(program: Program, n_in: int, u: npt.NDArray[np.int16], selected: list[int] | None = None) -> I64:
    metadata = {**METADATA, "operator.out_shift": str(program.out_shift)}
    data = pack(program.tensors("operator"), metadata).data
    library = ctypes.CDLL(str(native_folder() / "libruffini_stages.so"))
    out = np.zeros((len(u), len(program.unfold)), np.int64)
    chosen = np.array(selected or [], np.uint32)
    error = ctypes.create_string_buffer(256)
    failed = library.program_run(
        data, ctypes.c_int64(len(data)), b"operator", n_in, len(program.unfold),
        u.ctypes.data_as(ctypes.c_void_p), len(u), chosen.ctypes.data_as(ctypes.c_void_p), len(chosen),
        out.ctypes.data_as(ctypes.c_void_p), error,
    )  # fmt: skip
    if failed:
        raise Refused(error.value.decode())
    return out


def mirror_of(program: Program) -> Mirror:
    return Mirror(program.tensors("operator"), {"operator.out_shift": str(program.out_shift)}, "operator")


def signed_index(rng: np.random.Generator, n: int, width: int, limit: int) -> npt.NDArray[np.int32]:
    table = rng.integers(1, limit + 1, (n, width)) * rng.choice([-1, 1], (n, width))
    table[rng.random((n, width)) < 0.2] = 0
    return table.astype(np.int32)


def random_plan(rng: np.random.Generator, n_in: int, n_out: int) -> Plan:
    """Any stages over any segments: nothing that a compiler would make, everything that a loader lets through."""
    lengths = [int(rng.integers(1, 150))]
    panels = []
    for stage in range(int(rng.integers(1, 5))):
        n_values = int(rng.integers(1, 120))
        for _ in range(int(rng.integers(1, 5))):
            source = int(rng.integers(0, stage + 1))
            segments = []
            for _ in range(int(rng.integers(1, 4))):
                first = int(rng.integers(0, lengths[source]))
                segments.append((first, int(rng.integers(1, lengths[source] - first + 1))))
            first_row = int(rng.integers(0, n_values))
            n_rows = int(rng.integers(1, n_values - first_row + 1))
            shape = (n_rows, sum(count for _, count in segments))
            matrix = rng.normal(size=shape) * 10.0 ** rng.uniform(-4, 1, shape)
            panels.append(Panel(stage, first_row, source, tuple(segments), matrix))
        lengths.append(n_values)
    fold, unfold = (int(v) for v in rng.choice([1, 2, 4], 2))
    return Plan(
        signed_index(rng, lengths[0], fold, n_in), signed_index(rng, n_out, unfold, lengths[-1]),
        tuple(lengths[1:]), panels,
    )  # fmt: skip


@pytest.mark.parametrize("seed", range(30))
def test_random_programs_are_equal_bit_for_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_in, n_out = (int(v) for v in rng.integers(1, 100, 2))
    program = quantise(random_plan(rng, n_in, n_out), "test")
    u = np.concatenate([
        rng.integers(-limit, limit + 1, (3, n_in)) * (rng.random((3, n_in)) < share)
        for limit, share in ((5, 1), (3000, 1), (32767, 1), (32767, 0.1))
    ] + [np.full((1, n_in), -32768), np.zeros((1, n_in))]).astype(np.int16)  # fmt: skip
    expected = np.array([mirror_of(program).times(row) for row in u])
    assert np.array_equal(run_core(program, n_in, u), expected)
    selected = sorted(set(rng.integers(0, n_out, 1 + n_out // 4).tolist()))
    assert np.array_equal(run_core(program, n_in, u, selected)[:, selected], expected[:, selected])


def test_integers_follow_the_plan() -> None:
    """A rank-3 product in two stages against float64."""
    rng = np.random.default_rng(5)
    left, right = rng.normal(size=(70, 3)), rng.normal(size=(3, 90)) / 9
    identity = [np.arange(1, n + 1, dtype=np.int32)[:, None] for n in (90, 70)]
    plan = Plan(*identity, (3, 70), [Panel(0, 0, 0, ((0, 90),), right), Panel(1, 0, 1, ((0, 3),), left)])
    u = rng.integers(-8000, 8001, (20, 90)).astype(np.int16)
    out = run_core(quantise(plan, "test"), 90, u)
    expected = u @ right.T @ left.T
    assert np.abs(out - expected).max() < 0.5 + 2e-4 * np.abs(expected).max()


def test_a_compiled_hierarchy_runs_within_its_certificate() -> None:
    rng = np.random.default_rng(8)
    place = np.column_stack([rng.uniform(0, 20e-3, (400, 2)), np.zeros(400)])
    sites = node_sites(place)
    distance = np.sqrt(np.square(sites.place_m[:, None] - sites.place_m[None]).sum(axis=-1) + 1e-6)
    matrix = (1 + sites.axis[:, None] * sites.axis) / distance
    compiled = compile_matrix(matrix, sites, sites, "test", shapes=(Shape(24, 2, 0.5),))
    assert compiled.form == "hierarchical leaf 24 levels 2"
    u = np.concatenate([rng.integers(-8000, 8001, (4, 1200)), rng.integers(-3, 4, (2, 1200))]).astype(np.int16)
    out = run_core(compiled.program, 1200, u)
    assert np.array_equal(out[0], mirror_of(compiled.program).times(u[0]))
    error = np.abs(out - u @ matrix.T)
    for axis, worst in enumerate(compiled.certificate.worst_steps):
        assert error[:, axis::3].max() <= worst
    # Small inputs are as exact as large ones: the kept vectors float with them.
    assert np.linalg.norm(error[4:]) < 2e-3 * np.linalg.norm(u[4:] @ matrix.T) + 0.5 * np.sqrt(2400)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda p: replace(p, entry=np.full_like(p.entry, 16383), shift=np.full_like(p.shift, 40)), "overflow"),
        (lambda p: replace(p, entry=p.entry + np.int16(16384)), "overflow"),
        (lambda p: replace(p, shift=np.full_like(p.shift, 41)), "overflow"),
        (lambda p: replace(p, stage=p.stage * np.array([1, 0], np.int32)), "overflow"),
        (lambda p: replace(p, fold=p.fold + np.int32(1)), "input that is not there"),
        (lambda p: replace(p, unfold=-p.unfold - np.int32(1)), "value that is not there"),
        (lambda p: replace(p, unfold=np.repeat(p.unfold, 5, axis=1)), "another shape"),
        (lambda p: replace(p, segment=p.segment + np.array([1, 0], np.int32)), "outside its vector"),
        (lambda p: replace(p, segment=-p.segment), "segment makes no sense"),
        (lambda p: replace(p, panel=p.panel[::-1].copy()), "out of order"),
        (lambda p: replace(p, panel=p.panel + np.array([0, 1, 0, 0, 0, 0], np.int32)), "too tall"),
        (lambda p: replace(p, panel=p.panel + np.array([0, 0, 0, 2, 0, 0], np.int32)), "not there yet"),
        (lambda p: replace(p, panel=p.panel + np.array([0, 0, 0, 0, 0, 9], np.int32)), "segments that are not there"),
        (lambda p: replace(p, panel=-p.panel), "negative"),
        (lambda p: replace(p, panel=p.panel - np.array([0, 0, 1, 0, 0, 0], np.int32)), "smaller than its entries"),
        (lambda p: replace(p, entry=p.entry[:-32]), "do not match"),
        (lambda p: replace(p, out_shift=61), "out_shift"),
    ],
)  # fmt: skip
def test_what_could_go_wrong_is_refused(change, what) -> None:
    rng = np.random.default_rng(1)
    matrices = rng.normal(size=(40, 90)), rng.normal(size=(70, 40))
    identity = [np.arange(1, n + 1, dtype=np.int32)[:, None] for n in (90, 70)]
    plan = Plan(*identity, (40, 70), [Panel(0, 0, 0, ((0, 90),), matrices[0]), Panel(1, 0, 1, ((0, 40),), matrices[1])])
    program = quantise(plan, "test")
    u = np.ones((1, 90), np.int16)
    run_core(program, 90, u)
    with pytest.raises(Refused, match=what):
        run_core(change(program), 90, u)
