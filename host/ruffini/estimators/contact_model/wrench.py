"""Wrench of a texture's flow on a pad that its reflections leave as it is: K of kind `wrench`, one axis at a time.

A reflection of pad and picture turns a flow into another one and changes the sign of some axes of the wrench. So K of
an axis is sought among those that do the same: a quarter of the numbers, and what is learned in the middle holds on
either side. With it the reference sensor's crosstalk shows: a straight press in the middle makes a flow without any
shear in it, whatever the sensor's sideways channels read, so a part of Fz in them is fitted beside K and left out.
Not in the paper, whose Ft and moment are proportional to the sum of the flow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.contact_model.log import Press

Array = npt.NDArray[np.float64]

TO_NMM = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
SIGN_X = (-1, 1, 1, 1, -1, -1)  # of Fx Fy Fz Tx Ty Tz where x becomes -x
SIGN_Y = (1, -1, 1, -1, 1, -1)
NORMAL, TURN = 2, 5
RIDGE_PX2 = 30.0  # sum of squares of the flow that counts as noise
FREE = 1e-9


@dataclass(frozen=True)
class ContactWrench:
    """gain (6, n) N and N mm a pixel of flow; crosstalk (6,) of the reference: part of Fz, N/N and N mm/N."""

    gain: Array
    crosstalk: Array

    def __call__(self, flow: Array) -> Array:
        return np.asarray(flow @ self.gain.T)


def reference_of(press: Press) -> Array:
    """(t, 6) N and N mm."""
    return np.asarray(press.force * TO_NMM)


def fit_contact_wrench(board: Board, presses: list[Press], ridge: float = RIDGE_PX2) -> ContactWrench:
    """K and the reference's crosstalk.

    Raises
    ------
    InputError
        The lattice does not lie symmetrically on the pad.
    """
    lattice = lattice_of(board)
    flow = np.concatenate([p.flow[p.is_good] for p in presses])
    wrench = np.concatenate([reference_of(p)[p.is_good] for p in presses])
    gain, crosstalk = np.zeros((6, flow.shape[1])), np.zeros(6)
    quarter = _quarter(lattice)
    for axis in range(6):
        columns = symmetric(flow, lattice, axis)[:, quarter]
        weight = np.full(columns.shape[1], ridge / 4)  # each stands for four
        if axis != NORMAL:
            columns, weight = np.column_stack([columns, wrench[:, NORMAL]]), np.append(weight, FREE)
        found = np.linalg.solve(columns.T @ columns + np.diag(weight), columns.T @ wrench[:, axis])
        own = np.zeros((1, flow.shape[1]))
        own[0, quarter] = found[: quarter.sum()]
        gain[axis] = symmetric(own, lattice, axis)[0]
        crosstalk[axis] = 0.0 if axis == NORMAL else found[-1]
    return ContactWrench(gain, crosstalk)


def moment_per_flow(board: Board, presses: list[Press], wrench: ContactWrench) -> float:
    """k of the paper's moment k S_t, N mm a um of mean flow: least squares through the origin, of sizes."""
    um_per_px = 1e3 * board.camera.standoff_um / board.camera.focal_mpx
    flow, moment = [], []
    for p in presses:
        reference = reference_of(p) - np.outer(reference_of(p)[:, NORMAL], wrench.crosstalk)
        mean = p.flow.reshape(len(p.flow), -1, 2).mean(axis=1) * um_per_px
        flow.append(np.linalg.norm(mean, axis=1)[p.is_good])
        moment.append(np.abs(reference[p.is_good, TURN]))
    s, size = np.concatenate(flow), np.concatenate(moment)
    return float(s @ size / max(s @ s, FREE))


def _quarter(lattice: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Which of the flow's numbers stand for all: the others follow by reflection."""
    is_own = np.zeros((*lattice, 2), dtype=np.bool_)
    is_own[: lattice[0] // 2, : lattice[1] // 2] = True
    return is_own.ravel()


def lattice_of(board: Board) -> tuple[int, int]:
    """Rows and columns of the patches.

    Raises
    ------
    InputError
        There are none, or they are not as far from the pad's left side as from its right.
    """
    m = board.markers
    if m is None or m.n_x % 2 or m.n_y % 2:
        raise InputError(f"board {board.name!r} has no even number of patches each way: there is no flow to reflect")
    ends = (2 * m.first_x_um + (m.n_x - 1) * m.pitch_x_um, 2 * m.first_y_um + (m.n_y - 1) * m.pitch_y_um)
    if ends != (board.pad.size_x_um, board.pad.size_y_um):
        raise InputError(f"board {board.name!r}: its patches do not lie in the middle of the pad, as a fit by "
                         "symmetry needs: use cal fit --only wrench")  # fmt: skip
    return m.n_y, m.n_x


def symmetric(flow: Array, lattice: tuple[int, int], axis: int) -> Array:
    """The part of flows (t, n) that reflections change as they change this axis of the wrench."""
    n_y, n_x = lattice
    all_ = flow.reshape(-1, n_y, n_x, 2)
    half = (all_ + SIGN_X[axis] * all_[:, :, ::-1] * [-1, 1]) / 2
    return np.asarray(((half + SIGN_Y[axis] * half[:, ::-1] * [1, -1]) / 2).reshape(len(flow), -1))
