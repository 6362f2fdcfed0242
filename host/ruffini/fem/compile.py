"""float64 matrix -> the board's program of integer products, with its certificate.

Candidates are dense and hierarchical programs over the reflection classes of the matrix; the cost model
picks the cheapest. See README.md for what each route gives.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.fem.certificate import DISPLACEMENT_LSB_NM, Certificate, certify
from ruffini.fem.clusters import cluster_order
from ruffini.fem.program import Panel, Plan, Program, quantise
from ruffini.fem.symmetry import ReflectionClass, Sites, reflection_classes

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Compiled:
    """A program, what it costs against float64, and how it was made (`dense`, `dense/4`, ...)."""

    program: Program
    certificate: Certificate
    form: str


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
) -> Compiled:
    """Compile a matrix (n_rows, n_cols), in output steps per input step.

    Parameters
    ----------
    max_error : float
        Largest relative L2 error, for independent inputs and for `samples`.
    max_bytes : int or None
        Room that the board has for this program.
    samples : (n_cols, n) float64 or None
        Inputs as they really come, to judge the error on.

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
    classes = reflection_classes(matrix, rows, columns)
    plan = dense_plan(classes, rows, columns)
    program = quantise(plan, what)
    proof = certify(program, matrix, rows.axis, samples)
    form = "dense" if len(classes) == 1 else f"dense/{len(classes)}"
    error = max(proof.total, proof.samples)
    if error > max_error:
        raise InputError(f"rounding {what} to 15 bits costs {error:.1e} (relative L2), more than {max_error:.1e}")
    if max_bytes is not None and program.n_bytes > max_bytes:
        raise InputError(
            f"{what} takes {program.n_bytes / 1e6:.1f} MB as {form}, more than the {max_bytes / 1e6:.1f} MB that the "
            "board has for it: use fewer nodes or raise [memory] calibration_kb"
        )
    return Compiled(program, proof, form)


def dense_plan(classes: list[ReflectionClass], rows: Sites, columns: Sites) -> Plan:
    """One stage with one panel for each class; columns in the order of their places, so that blocks are local."""
    fold, panels, n_slots, n_values = [], [], 0, 0
    unfold: list[list[int]] = [[] for _ in range(len(rows))]
    for block in classes:
        row_order = cluster_order(rows.place_m[np.abs(block.rows[:, 0]) - 1])
        column_order = cluster_order(columns.place_m[np.abs(block.columns[:, 0]) - 1])
        fold.append(block.columns[column_order])
        panels.append(
            Panel(0, n_values, 0, ((n_slots, len(column_order)),), block.matrix[np.ix_(row_order, column_order)])
        )
        add_outputs(unfold, block.rows[row_order], n_values)
        n_slots += len(column_order)
        n_values += len(row_order)
    return Plan(np.concatenate(fold).astype(np.int32), rectangle(unfold), (n_values,), panels)


def add_outputs(unfold: list[list[int]], rows: npt.NDArray[np.int64], first: int) -> None:
    """Note for each output that a class's row spreads to: value `first` + row, with its sign."""
    for value, members in enumerate(rows, start=first + 1):
        for member in members:
            if member:
                unfold[abs(member) - 1].append(value if member > 0 else -value)


def rectangle(unfold: list[list[int]]) -> npt.NDArray[np.int32]:
    """Zero padded to one length."""
    width = max(len(members) for members in unfold)
    return np.array([members + [0] * (width - len(members)) for members in unfold], np.int32)
