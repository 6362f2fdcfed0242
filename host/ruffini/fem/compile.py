"""float64 matrix -> the board's program of integer products, with its certificate.

Candidates are a dense program and hierarchical ones, each over the reflection classes of the matrix
(symmetry.py); the cost model picks the cheapest that meets the error. DESIGN.md says what each route gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.fem.certificate import DISPLACEMENT_LSB_NM, Certificate, certify, probed_error
from ruffini.fem.clusters import cluster_order
from ruffini.fem.hierarchy import Shape, Sorted, hierarchical_plan, sort_class
from ruffini.fem.program import Panel, Plan, Program, quantise
from ruffini.fem.symmetry import ReflectionClass, Sites, reflection_classes

Array = npt.NDArray[np.float64]
Int32 = npt.NDArray[np.int32]
Progress = Callable[[float], None]

# Cost of a panel beside its entries, as entries: its gather, its calls, its part of a cache line.
PANEL_COST, COLUMN_COST = 1000, 4
SHAPES = tuple(Shape(leaf, n_levels, 0.5) for leaf in (64, 32, 128) for n_levels in (4, 3, 2, 1))  # best first
SMALLEST_HIERARCHY = 500_000  # entries of all classes: below, panels cost more than they save
WORTH = 0.75  # of the cost so far: a candidate that saves less is not worth its error
MAX_TRIES = 6  # at the threshold that meets the error
PROBED_ROWS = 500  # looked at before a whole certificate is made
FIRST_THRESHOLD = 0.7  # of the error allowed: rounding takes the rest


@dataclass(frozen=True)
class Compiled:
    """A program, what it costs against float64, and how it was made.

    `form`: `dense`, `dense/4` (in four reflection classes), `hierarchical/4 leaf 96 levels 2`. `n_entries`: what
    a run reads, padding included.
    """

    program: Program
    certificate: Certificate
    form: str

    @property
    def n_entries(self) -> int:
        return len(self.program.entry)


@dataclass(frozen=True)
class Job:
    """What is to be compiled, and how well."""

    matrix: Array
    rows: Sites
    columns: Sites
    what: str
    max_error: float
    samples: Array | None
    max_sample_error: float

    def excess(self, total: float, on_samples: float) -> float:
        """The larger of both errors over what is allowed; above 1 is too much."""
        return max(total / self.max_error, on_samples / self.max_sample_error)


def force_steps(force_lsb_un: int) -> float:
    """Output steps per input step of an operator of 1 newton per metre."""
    return DISPLACEMENT_LSB_NM * 1e-9 / (force_lsb_un * 1e-6)


def compile_matrix(
    matrix: Array,
    rows: Sites,
    columns: Sites,
    what: str,
    *,
    max_error: float = 1e-3,
    max_bytes: int | None = None,
    samples: Array | None = None,
    max_sample_error: float | None = None,
    reflect: bool = True,
    shapes: tuple[Shape, ...] = SHAPES,
    progress: Progress = lambda _: None,
) -> Compiled:
    """Compile any matrix (n_rows, n_cols), in output steps per input step.

    Parameters
    ----------
    max_error : float
        Largest relative L2 error for independent inputs.
    max_bytes : int or None
        Room that the board has for this program.
    samples : (n_cols, n) float64 or None
        Inputs as they really come, to judge the error on, too.
    max_sample_error : float or None
        Largest relative L2 error for `samples`; None: `max_error`.
    reflect : bool
        Use reflections. Not for a matrix of which the board multiplies small parts only.
    shapes : tuple of Shape
        Hierarchies to consider beside the dense program.

    Raises
    ------
    InputError
        When the matrix is not finite or all zero, the error cannot be met, or the program is larger than the
        board's memory.
    """
    if matrix.ndim != 2 or not np.isfinite(matrix).all() or not matrix.any():
        raise InputError(f"{what} is not a finite, non-zero matrix: nothing to compile")
    if matrix.shape != (len(rows), len(columns)):
        raise InputError(f"{what} is {matrix.shape}, its sites are {(len(rows), len(columns))}")
    job = Job(matrix, rows, columns, what, max_error, samples, max_sample_error or max_error)
    classes = reflection_classes(matrix, rows, columns, use=reflect)
    suffix = f"/{len(classes)}" if len(classes) > 1 else ""
    compiled = None
    chosen = _cheapest_shape(job, classes, shapes, lambda done: progress(0.6 * done))
    if chosen is not None:
        sorted_classes = [sort_class(c, rows, columns, chosen) for c in classes]
        compiled = _hierarchical(job, sorted_classes, f"hierarchical{suffix} leaf {chosen.leaf}")
    progress(0.8)
    if compiled is None:
        plan = dense_plan(classes, rows, columns)
        program = quantise(plan, what)
        compiled = Compiled(program, certify(program, matrix, rows.axis, samples), f"dense{suffix}")
    proof = compiled.certificate
    for on, error, allowed in (
        ("independent inputs", proof.total, job.max_error), ("samples", proof.samples, job.max_sample_error)
    ):  # fmt: skip
        if error > allowed:
            raise InputError(
                f"rounding {what} to 15 bits costs {error:.1e} (relative L2 on {on}), more than {allowed:.1e}: "
                "allow more error"
            )
    if max_bytes is not None and compiled.program.n_bytes > max_bytes:
        raise InputError(
            f"{what} takes {compiled.program.n_bytes / 1e6:.1f} MB as {compiled.form}, more than the "
            f"{max_bytes / 1e6:.1f} MB that the board has for it ([memory] calibration_kb in board.toml): fewer nodes"
        )
    progress(1.0)
    return compiled


def cost(plan: Plan) -> float:
    """Entries read, and what each panel and each gathered column takes, in entries."""
    columns = sum(panel.matrix.shape[1] for panel in plan.panels)
    return float(plan.n_entries + PANEL_COST * len(plan.panels) + COLUMN_COST * columns)


def _cheapest_shape(
    job: Job, classes: list[ReflectionClass], shapes: tuple[Shape, ...], progress: Progress
) -> Shape | None:
    """The hierarchy that costs least at the first threshold; None where dense costs no more."""
    n_entries = sum(c.matrix.size for c in classes)
    if n_entries < SMALLEST_HIERARCHY:
        return None
    best, best_cost, last_leaf, is_worse = None, WORTH * n_entries, 0, False
    for i, shape in enumerate(shapes):
        progress((i + 1) / len(shapes))
        if shape.leaf == last_leaf and is_worse:
            continue  # fewer levels of the same clusters cost still more
        found = _cost_of(job, classes, shape, best_cost)
        if found is None:
            continue
        last_leaf, is_worse = shape.leaf, found >= best_cost
        if not is_worse:
            best, best_cost = shape, WORTH * found
    return best


def _cost_of(job: Job, classes: list[ReflectionClass], shape: Shape, most: float) -> float | None:
    """Of a hierarchy at the first threshold; None where it has too few levels, or its near part alone costs `most`.

    Nothing of it is kept: a sorted copy of the matrix is what fills the memory.
    """
    sorted_classes = [sort_class(c, job.rows, job.columns, shape) for c in classes]
    near = sum(c.near_share * c.matrix.size for c in sorted_classes)
    if min(len(c.levels) for c in sorted_classes) < shape.n_levels or near > most:
        return None
    plan = hierarchical_plan(sorted_classes, _threshold(job, sorted_classes, FIRST_THRESHOLD), _no_unfold(job))
    return None if plan is None else cost(plan)


def _threshold(job: Job, classes: list[Sorted], share: float) -> float:
    """Singular values of a cluster below this are cut: what is cut adds up to `share` of the error allowed."""
    n_clusters = sum(len(level) for c in classes for level in c.levels)
    size = np.sqrt(sum(float(np.linalg.norm(c.matrix)) ** 2 for c in classes))
    return float(share * job.max_error * size / np.sqrt(n_clusters))


def _hierarchical(job: Job, classes: list[Sorted], form: str) -> Compiled | None:
    """At the largest threshold that meets the error; None where none of a few does."""
    share = FIRST_THRESHOLD
    unfold = _unfold(len(job.rows), [c.rows for c in classes])
    for _ in range(MAX_TRIES):
        plan = hierarchical_plan(classes, _threshold(job, classes, share), unfold)
        if plan is None:
            return None
        program = quantise(plan, job.what)
        excess = job.excess(*probed_error(program, job.matrix, job.samples, PROBED_ROWS))
        if excess <= 1:
            proof = certify(program, job.matrix, job.rows.axis, job.samples)
            excess = job.excess(proof.total, proof.samples)
        if excess <= 1:
            return Compiled(program, proof, f"{form} levels {len(plan.sizes) // 2}")
        share *= min(0.8 / excess, 0.7)
    return None


def _no_unfold(job: Job) -> Int32:
    """For a plan that is only costed."""
    return np.zeros((len(job.rows), 1), np.int32)


def dense_plan(classes: list[ReflectionClass], rows: Sites, columns: Sites) -> Plan:
    """One stage with one panel for each class; columns in the order of their places, so that blocks are local."""
    fold, panels, outputs, n_slots, n_values = [], [], [], 0, 0
    for block in classes:
        row_order = cluster_order(rows.place_m[np.abs(block.rows[:, 0]) - 1])
        column_order = cluster_order(columns.place_m[np.abs(block.columns[:, 0]) - 1])
        fold.append(block.columns[column_order])
        outputs.append(block.rows[row_order])
        panels.append(
            Panel(0, n_values, 0, ((n_slots, len(column_order)),), block.matrix[np.ix_(row_order, column_order)])
        )
        n_slots += len(column_order)
        n_values += len(row_order)
    return Plan(np.concatenate(fold).astype(np.int32), _unfold(len(rows), outputs), (n_values,), panels)


def _unfold(n_out: int, outputs: list[npt.NDArray[np.int64]]) -> Int32:
    """For each output the values of the classes' rows that make it, zero padded to one length."""
    values: list[list[int]] = [[] for _ in range(n_out)]
    for value, members in enumerate(_lines(outputs), start=1):
        for member in members:
            if member:
                values[abs(member) - 1].append(value if member > 0 else -value)
    width = max(len(v) for v in values)
    return np.array([v + [0] * (width - len(v)) for v in values], np.int32)


def _lines(tables: list[npt.NDArray[np.int64]]) -> Iterator[list[int]]:
    for table in tables:
        yield from table.tolist()
