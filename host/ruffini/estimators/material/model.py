"""What a log's displacements say of its wrenches for any (E, nu, h), and how well they fit each pad.

The estimator's wrench W(u; E, nu, h) is linear in E and smooth in (nu, h): it is computed with the board's own second
pass on a 3 x 3 grid of (nu, h) around the board's numbers and interpolated there. At finite strain the pass adds what
that makes to second order (fem/finite_strain.py), which is linear in E, too; its weights are those of the board's pad
everywhere on the grid.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.operator.fit import board_slab, board_window_m, finite_strain_of, observed_unknowns
from ruffini.fem.condense import condense
from ruffini.fem.operators import Noise, force_operator
from ruffini.fem.slab import Slab
from ruffini.fem.support import SupportSystem, contact_mask, solve_on_support, support_system

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

THICKNESS_FACTORS = (0.9, 1.0, 1.1)
POISSON_FACTORS = (0.94, 1.0, 1.035)
# At finite strain the pressure's part grows with 1 / (1 - 2 nu), which no quadratic follows farther, and the law's
# elements lock near 0.5.
FINITE_POISSON_FACTORS = (0.97, 1.0, 1.015)
HIGHEST_FINITE_POISSON = 0.493
HIGHEST_FITTED_POISSON = 0.4985
SHAPE_DEVIATION = 0.01  # of the displacement from any pad's, part of what touches explain of it (L2)
SHAPE_LINES = 41  # along nu and h, on which the least misfit is looked for


@dataclass(frozen=True)
class MaterialLog:
    """Displacement (t, m, 3) m at the observed nodes, reference wrench (t, 6) N and N m, number of the touch (t,).

    What a reference does not measure is NaN in all frames.
    """

    displacement: Array
    wrench: Array
    touch: npt.NDArray[np.int64]

    @property
    def seen(self) -> npt.NDArray[np.bool_]:
        """Which of the six numbers the reference measures."""
        return np.asarray(np.isfinite(self.wrench).all(axis=0))


class Predictor:
    """Wrench of every frame, displacement (t, m, 3) m, for any (E, nu, h) within the grid."""

    def __init__(
        self, board: Board, displacement: Array, noise: Noise, progress: Progress, *, is_finite: bool = False
    ) -> None:
        slab = board_slab(board)
        observed = observed_unknowns(board)
        self.is_finite = is_finite
        self.nominal = np.array([slab.modulus_pa, slab.poisson, slab.thickness_m])
        self.poisson = (
            _poisson_grid(slab.poisson, FINITE_POISSON_FACTORS, HIGHEST_FINITE_POISSON)
            if is_finite
            else _poisson_grid(slab.poisson, POISSON_FACTORS, HIGHEST_FITTED_POISSON)
        )
        self.thickness = slab.thickness_m * np.array(THICKNESS_FACTORS)
        u = displacement.reshape(len(displacement), -1)
        rows, columns = board.observed
        shape = (rows.stop - rows.start, columns.stop - columns.start, 3)
        operator = force_operator(slab, "optimal", noise=noise, window_m=board_window_m(board))
        linear = u @ operator.T

        def beyond_of(pad: Slab) -> Array | None:
            """(t, 3 m) N, or nothing at linear strain."""
            if not is_finite:
                return None
            law = finite_strain_of(board, pad)
            return np.array([law.force(one.reshape(shape)).ravel() for one in u])

        of_board = beyond_of(slab)
        masks = [
            contact_mask(f.reshape(shape)[..., 2], threshold_n=board.contact.threshold_un * 1e-6,
                         min_nodes=board.contact.min_nodes)
            for f in (linear if of_board is None else linear + of_board)
        ]  # fmt: skip
        arms = _arms(board, slab)
        self.at_grid = np.empty((3, 3, len(u), 6))
        self.misfit = np.empty((3, 3, len(u)))
        for i, poisson in enumerate(self.poisson):
            for j, thickness in enumerate(self.thickness):
                pad = replace(slab, poisson=poisson, thickness_m=thickness)
                system = system_of(pad, noise, observed, operator)
                self.at_grid[i, j], self.misfit[i, j] = _wrenches(system, u, linear, beyond_of(pad), masks, arms)
                progress((3 * i + j + 1) / 9)

    def part(self, frames: slice) -> Predictor:
        """The same for some of the frames; what it costs to make is shared."""
        one = copy.copy(self)
        one.at_grid, one.misfit = self.at_grid[:, :, frames], self.misfit[:, :, frames]
        return one

    def wrench(self, values: Array) -> Array:
        """(t, 6); quadratic in nu and h, linear in E."""
        along_nu = _lagrange(self.poisson, values[1])
        along_h = _lagrange(self.thickness, values[2])
        per_modulus = np.einsum("i,j,ijtc->tc", along_nu, along_h, self.at_grid) / self.nominal[0]
        return np.asarray(per_modulus * values[0])


def system_of(slab: Slab, noise: Noise, observed: npt.NDArray[np.bool_], operator: Array) -> SupportSystem:
    """The board's second pass for a pad, from the estimate of `operator`."""
    return support_system(condense(slab), noise, observed, operator)


class Shape:
    """How much worse (nu, h) explain the displacement of some frames than the best pad does, in standard deviations."""

    def __init__(self, predictor: Predictor, used: npt.NDArray[np.bool_]) -> None:
        self._poisson, self._thickness = predictor.poisson, predictor.thickness
        self._misfit = predictor.misfit[:, :, used].mean(axis=2)
        along = [
            _lagrange(axis, np.linspace(axis[0], axis[2], SHAPE_LINES)) for axis in (self._poisson, self._thickness)
        ]
        self._least = float((along[0].T @ self._misfit @ along[1]).min())

    def deviation(self, values: Array) -> float:
        """Zero where they explain it as well as any pad."""
        at = float(_lagrange(self._poisson, values[1]) @ self._misfit @ _lagrange(self._thickness, values[2]))
        explained = max(-self._least, 1e-9)  # of u^T R^-1 u, which is the same for all pads
        return float(np.sqrt(max(at - self._least, 0.0) / explained) / SHAPE_DEVIATION)


def _poisson_grid(poisson: float, factors: tuple[float, float, float], highest: float) -> Array:
    """Three ratios about the board's, none above the highest, and apart."""
    middle = min(poisson, highest / factors[2] ** 0.5)
    grid = np.minimum(middle * np.array(factors), highest)
    if grid[2] - grid[0] < 1e-3:
        raise InputError(f"Poisson's ratio {poisson:g} of the board cannot be fitted: write what a datasheet says")
    return np.asarray(grid)


def _arms(board: Board, slab: Slab) -> Array:
    """Places of the observed nodes from the pad's centre, (m, 3) m."""
    rows, columns = board.observed
    x = (np.arange(slab.n_x) - (slab.n_x - 1) / 2)[columns] * slab.step_m[0]
    y = (np.arange(slab.n_y) - (slab.n_y - 1) / 2)[rows] * slab.step_m[1]
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return np.column_stack([grid, np.zeros(len(grid))])


def _wrenches(
    system: SupportSystem, u: Array, linear: Array, beyond: Array | None, masks: list[tuple[Array, float]], arms: Array
) -> tuple[Array, Array]:
    """Wrench of each frame, and (v - C F)^T R^-1 (v - C F) less u^T R^-1 u, where v = u + C Q."""
    force = np.array([
        solve_on_support(system, u[k], linear[k] if beyond is None else linear[k] + beyond[k], mask.ravel(),
                         threshold_n=threshold_n, beyond_n=None if beyond is None else beyond[k])
        for k, (mask, threshold_n) in enumerate(masks)
    ])  # fmt: skip
    linear_y = (force if beyond is None else force - beyond) / system.scale_n  # v - C F = u - C (F - Q)
    misfit = np.einsum("ti,ti->t", linear_y, linear_y @ system.normal - 2 * (u @ system.project.T))
    nodal = force.reshape(len(u), -1, 3)
    # At finite strain forces act where the nodes have gone, as a load cell reads them (proto/README.md).
    places = arms if beyond is None else arms + u.reshape(nodal.shape)
    return np.concatenate([nodal.sum(axis=1), np.cross(places, nodal).sum(axis=1)], axis=1), misfit


def _lagrange(nodes: Array, at: float | Array) -> Array:
    """Weights of the quadratic through three nodes, (3,) or (3, n)."""
    a, b, c = nodes
    return np.array([
        (at - b) * (at - c) / ((a - b) * (a - c)),
        (at - a) * (at - c) / ((b - a) * (b - c)),
        (at - a) * (at - b) / ((c - a) * (c - b)),
    ])  # fmt: skip
