"""Compiled operators against Eigen's float32 matrix times vector, cache-cold, on one core.

The synthetic operator is the compliance of an elastic half space (Boussinesq and Cerruti) between scattered
places, so that no reflection helps; it stands for any smooth, decaying operator, and can be as large as one
likes. The board's own operator follows. Every row is measured in one run with its peers. Then the board's whole solve
(operator, second pass, stated sigma) against its operator alone, on touches of three sizes.

Takes three minutes and 7 GB; `--build` is a folder compiled with -DRUFFINI_BENCH=ON.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.bench.states import Recipe, Touch, make_states
from ruffini.boards import find_board
from ruffini.calibrate.container import base_metadata, pack, write
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.error_model import N_TOUCHES
from ruffini.estimators.operator.fit import Tensors, make_operator
from ruffini.fem.compile import SHAPES, compile_matrix
from ruffini.fem.operators import Noise
from ruffini.fem.symmetry import Sites, node_sites

Array = npt.NDArray[np.float64]

STEP_M = 0.65e-3
POISSON = 0.48
LARGEST_EIGEN = 12_500  # unknowns: 0.6 GB of float32
FLUSH_BYTES = 96 << 20  # written before every timed solve: nothing stays in the caches
N_SOLVES = 31
# Of the whole solve: balls of the twin, radius and depth in mm, dragged by a tenth of the depth.
TOUCHES = ((4, 0.3), (6, 0.6), (8, 1.0))
METADATA = {"format": "ruffini-calibration", "format_version": "1", "product": "ruffini"}


@dataclass(frozen=True)
class Row:
    """One compiled operator and what one product takes; `share`: entries read / entries of the matrix."""

    name: str
    n: int
    form: str
    error: float
    share: float
    megabytes: float
    program_ms: float
    eigen_ms: float  # 0: not measured
    read_gb_s: float
    compile_s: float

    @property
    def gb_s(self) -> float:
        return self.megabytes / self.program_ms


def scattered_nodes(n_x: int, n_y: int) -> Sites:
    """Vectors at places within a fifth of a step of a lattice."""
    x, y = np.meshgrid(np.arange(n_x) * STEP_M, np.arange(n_y) * STEP_M)
    place = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    place[:, :2] += np.random.default_rng(0).uniform(-STEP_M / 5, STEP_M / 5, (len(place), 2))
    return node_sites(place)


def half_space(sites: Sites) -> Array:
    """Surface displacement per force, 2 pi G u = ..., softened by half a step; largest entry about 30 steps.

    Johnson, Contact Mechanics, eqs. (3.18) and (3.75 to 3.77) at z = 0, with nu = POISSON.
    """
    place = sites.place_m[::3]
    n = len(place)
    out = np.empty((n, 3, n, 3))
    for i in range(n):
        d = place[i] - place
        r2 = np.square(d).sum(axis=1) + (STEP_M / 2) ** 2
        r = np.sqrt(r2)
        turn = (0.5 - POISSON) * d[:, :2] / r2[:, None]
        out[i, 0, :, 0] = (1 - POISSON) / r + POISSON * d[:, 0] ** 2 / (r2 * r)
        out[i, 1, :, 1] = (1 - POISSON) / r + POISSON * d[:, 1] ** 2 / (r2 * r)
        out[i, 0, :, 1] = out[i, 1, :, 0] = POISSON * d[:, 0] * d[:, 1] / (r2 * r)
        out[i, 2, :, 2] = (1 - POISSON) / r
        out[i, :2, :, 2] = -turn.T
        out[i, 2, :, :2] = turn
    matrix = out.reshape(3 * n, 3 * n)
    matrix *= 30 / matrix.max()
    return matrix


def measure(
    name: str, tensors: Tensors, metadata: dict[str, str], shape: tuple[int, int], binary: Path, folder: Path,
    compile_s: float,
) -> Row:  # fmt: skip
    """`tensors`, `metadata`: of a calibration file with the program `operator`."""
    path = folder / "operator.safetensors"
    program = {k: v for k, v in tensors.items() if k.startswith("operator.")}
    write(path, pack(program, {**METADATA, **metadata}))
    n_out, n_in = shape
    has_eigen = max(shape) <= LARGEST_EIGEN
    command = [str(binary), str(path), str(n_in), str(n_out), "31", str(int(has_eigen))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{binary} failed: {done.stderr.strip()}")
    path.unlink()
    result = json.loads(done.stdout)
    return Row(
        name, n_in, metadata["operator.form"], int(metadata["operator.error_1e9"]) * 1e-9,
        program["operator.entry"].size / (n_in * n_out), sum(t.nbytes for t in program.values()) / 1e6,
        result["program_ms"], result["eigen_ms"], result["read_gb_s"], compile_s,
    )  # fmt: skip


def synthetic_row(n_x: int, n_y: int, binary: Path, folder: Path, *, dense: bool) -> Row:
    sites = scattered_nodes(n_x, n_y)
    matrix = half_space(sites)
    start = time.perf_counter()
    compiled = compile_matrix(matrix, sites, sites, "the half space", shapes=() if dense else SHAPES)
    seconds = time.perf_counter() - start
    metadata = {
        "operator.out_shift": str(compiled.program.out_shift),
        "operator.form": compiled.form,
        "operator.error_1e9": str(round(compiled.certificate.total * 1e9)),
    }
    tensors = compiled.program.tensors("operator")
    return measure("half space (synthetic)", tensors, metadata, matrix.shape, binary, folder, seconds)


def board_row(name: str, binary: Path, folder: Path) -> Row:
    """The board's own operator, as `ruffini cal fit --only operator` makes it."""
    start = time.perf_counter()
    kind = make_operator(find_board(name), method="optimal", noise=Noise((5e-6, 5e-6, 2e-5)))
    seconds = time.perf_counter() - start
    return measure(f"{name} (optimal)", kind.tensors, kind.metadata, kind.matrix.shape, binary, folder, seconds)


@dataclass(frozen=True)
class Solve:
    """A touch and what its parts take, ms: the operator alone, with the second pass, and with the stated sigma too."""

    touched: int
    operator_ms: float
    support_ms: float
    whole_ms: float

    @property
    def ratio(self) -> float:
        return self.whole_ms / self.operator_ms


def solve_ms(pipeline: Pipeline, u: npt.NDArray[np.int16]) -> float:
    """Median time of a solve, cache-cold."""
    flush = np.zeros(FLUSH_BYTES // 8)
    times = []
    for _ in range(N_SOLVES):
        flush += 1
        start = time.perf_counter()
        pipeline.solve(u)
        times.append(time.perf_counter() - start)
    return 1e3 * float(np.median(times))


def whole_solves(name: str) -> list[Solve]:
    """Of a board as `ruffini cal fit --only operator` equips it, and with parts left out."""
    board = find_board(name)
    noise = Noise((5e-6, 5e-6, 2e-5))
    linear = make_operator(board, method="optimal", noise=noise)
    whole = make_operator(board, method="support", noise=noise, n_touches=N_TOUCHES)
    unsure = {k: v for k, v in whole.tensors.items() if not k.startswith("support.error")}
    kinds = [(linear.tensors, linear.metadata), (unsure, whole.metadata), (whole.tensors, whole.metadata)]
    pipelines = [Pipeline(board, pack(t, {**base_metadata(board), **m}).data) for t, m in kinds]
    out = []
    for radius_mm, depth_mm in TOUCHES:
        ball = Recipe("ball", (Touch("sphere", radius_mm, 0.3, -0.2, shift=(0.1 * depth_mm, 0.0)),))
        moved = make_states(board, (ball,), (depth_mm,))[0].displacement
        u = np.round(moved / DISPLACEMENT_LSB_M).astype(np.int16).reshape(1, -1, 3)
        times = [solve_ms(pipeline, u) for pipeline in pipelines]
        out.append(Solve(int(np.count_nonzero(pipelines[-1].raw("mask"))), *times))
    for pipeline in pipelines:
        pipeline.close()
    return out


def slope(rows: list[Row]) -> float:
    """Of log time over log unknowns, least squares."""
    return float(np.polyfit(np.log([r.n for r in rows]), np.log([r.program_ms for r in rows]), 1)[0])


def show(rows: list[Row]) -> None:
    print("one core, cache-cold, median of 31; against Eigen float32 matrix times vector of the same size")
    print(f"  {'operator':24}{'unknowns':>9} {'form':32}{'error':>9}{'read':>7}{'MB':>8}{'ms':>8}{'Eigen ms':>10}"
          f"{'faster':>8}{'GB/s':>7}{'of read':>9}{'compile s':>11}")  # fmt: skip
    for r in rows:
        eigen, faster = (f"{r.eigen_ms:.3f}", f"{r.eigen_ms / r.program_ms:.1f}x") if r.eigen_ms else ("-", "-")
        print(f"  {r.name:24}{r.n:9d} {r.form:32}{r.error:9.1e}{100 * r.share:6.1f}%{r.megabytes:8.1f}"
              f"{r.program_ms:8.3f}{eigen:>10}{faster:>8}{r.gb_s:7.1f}{100 * r.gb_s / r.read_gb_s:8.0f}%"
              f"{r.compile_s:11.1f}")  # fmt: skip


def show_solves(solves: list[Solve]) -> None:
    print("whole solve of the board, cache-cold, median of 31, estimators included: wanted at most 4x the operator")
    print(f"  {'touched nodes':>14}{'operator ms':>13}{'+ second pass':>15}{'+ sigma':>10}{'whole':>8}")
    for s in solves:
        print(f"  {s.touched:14d}{s.operator_ms:13.3f}{s.support_ms:15.3f}{s.whole_ms:10.3f}{s.ratio:7.1f}x")


def draw(rows: list[Row], path: Path) -> None:
    """Time over unknowns, ours and Eigen's."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    axes.loglog([r.n for r in rows], [r.program_ms for r in rows], "o-", label=f"compiled, slope {slope(rows):.2f}")
    peers = [r for r in rows if r.eigen_ms]
    axes.loglog([r.n for r in peers], [r.eigen_ms for r in peers], "s-", label="Eigen float32")
    axes.set(xlabel="unknowns", ylabel="one product, ms, cache-cold, one core", title="Half space (synthetic)")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build", type=Path, default=Path("build"))
    parser.add_argument("--quick", action="store_true", help="sizes up to 3,000 unknowns only")
    parser.add_argument("--json", action="store_true", help="one JSON array instead of the table")
    arguments = parser.parse_args()
    folder = arguments.build / "bench"
    folder.mkdir(parents=True, exist_ok=True)
    binary = arguments.build / "ruffini_scaling_bench"
    rows = [synthetic_row(40, 25, binary, folder, dense=True)]
    lattices = [(25, 20), (40, 25)] if arguments.quick else [(25, 20), (40, 25), (50, 40), (80, 50), (80, 60)]
    rows += [synthetic_row(n_x, n_y, binary, folder, dense=False) for n_x, n_y in lattices]
    scaling = rows[1:]
    rows.append(board_row("gelslim", binary, folder))
    solves = whole_solves("gelslim")
    draw(scaling, folder / "operator_scaling.png")
    if arguments.json:
        print(json.dumps({"operators": [asdict(r) for r in rows], "solves": [asdict(s) for s in solves]}))
        return
    show(rows)
    print(f"  log-log slope of time over unknowns, synthetic: {slope(scaling):.2f}; {folder / 'operator_scaling.png'}")
    show_solves(solves)


if __name__ == "__main__":
    main()
