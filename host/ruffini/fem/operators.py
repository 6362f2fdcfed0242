"""Inverse-FEM operators: nodal force on the surface from observed surface displacement, F = G U.

All methods are linear, so each is one matrix; `compile` turns it into the integers that the firmware
applies. Frame and sign: x right, y down in the image, z out of the pad, force ON the pad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
import scipy.linalg as la
import scipy.sparse as sp

from ruffini.errors import InputError
from ruffini.fem.condense import (
    CondensedSlab,
    Progress,
    condense,
    surface_stiffness,
)
from ruffini.fem.slab import Slab
from ruffini.reflection import blocks_from_dense, dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]
Method = Literal["raw", "ridge", "optimal"]
METHODS: tuple[str, ...] = get_args(Method)


LONG_NODES = 3.0  # noise d node steps apart has the correlation exp(-d^2 / (4 LONG_NODES^2))


@dataclass(frozen=True)
class Noise:
    """What disturbs the observed displacement of one node.

    Parameters
    ----------
    sigma_m : (3,) floats
        Standard deviation of the part that varies from node to node, along x, y, z.
    gauge_m : float
        Standard deviation of one constant added to every u_z: the free constant of the depth.
    tilt_m : float
        Standard deviation, at the edge of the pad, of a plane added to u_z.
    long_share : (3,) floats, optional
        Share of that part's variance, along x, y, z, that is correlated over LONG_NODES; the rest is white. Operators
        take all of it as white; the error model of the wrench needs it. None: not known.
    """

    sigma_m: tuple[float, float, float]
    gauge_m: float = 0.0
    tilt_m: float = 0.0
    long_share: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        values = (*self.sigma_m, self.gauge_m, self.tilt_m)
        if not all(np.isfinite(v) and v >= 0 for v in values) or min(self.sigma_m) <= 0:
            raise InputError(f"noise must be finite and, along x, y, z, above zero, got {values}")
        if self.long_share is not None and not all(0 <= share <= 1 for share in self.long_share):
            raise InputError(f"shares of noise with long correlation must be within 0 and 1, got {self.long_share}")


@dataclass(frozen=True)
class ForcePrior:
    """What nodal forces may be: zero mean, correlated between neighbours (optimal method only).

    `sigma_n` is the standard deviation of one nodal force on the finest scale, newtons, along
    x, y, z; `length_nodes` the correlation length in node steps, exp(-d^2 / (2 l^2)).
    """

    sigma_n: tuple[float, float, float] = (0.01, 0.01, 0.03)
    length_nodes: float = 1.5


def ridge_operator(condensed: CondensedSlab, weight: float) -> list[Array]:
    """iFEM 2.0, eq. (2): U_2 = (K_22^T K_22 + w I)^-1 K_22^T (-K_21 U_1 + n_0), per parity class.

    Parameters
    ----------
    weight : float
        w as a fraction of the largest eigenvalue of K_22^T K_22, so that it has no unit; 0 is iFEM
        raw. n_0, the mean of the noise, is zero after the rest image is subtracted and adds nothing.
    """
    spectra = [la.eigh(k_22) for k_22 in condensed.k_22]
    largest = max(float(values[-1]) for values, _ in spectra)
    w = weight * largest**2
    blocks = []
    for (values, vectors), k_11, k_12 in zip(spectra, condensed.k_11, condensed.k_12, strict=True):
        inner = (vectors * (values / (values**2 + w))) @ vectors.T
        blocks.append(k_11 - k_12 @ (k_12 @ inner).T)
    return blocks


def optimal_operator(condensed: CondensedSlab, noise: Noise, prior: ForcePrior) -> list[Array]:
    """Optimal linear estimate G = P C^T (C P C^T + R)^-1 per parity class. Not in the paper.

    C = S^-1 is the surface compliance, P the prior covariance of the forces, R that of the noise,
    with the depth's free constant and tilt as unknowns of large variance.
    """
    slab, bases = condensed.slab, condensed.bases
    prior_blocks = _prior_blocks(slab, bases, prior)
    nuisance = depth_modes(slab, noise)
    white = np.tile(np.square(noise.sigma_m), slab.n_nodes)
    blocks = []
    for stiffness, p, q in zip(surface_stiffness(condensed), prior_blocks, bases, strict=True):
        compliance = spd_inverse(stiffness)
        modes = q.T @ nuisance
        covariance = compliance @ p @ compliance + modes @ modes.T
        covariance += (q.T @ sp.diags(white) @ q).toarray()
        blocks.append(la.solve(covariance, compliance @ p, assume_a="pos").T)
    return blocks


def _prior_blocks(slab: Slab, bases: list[sp.csr_matrix], prior: ForcePrior) -> list[Array]:
    def kernel(n: int) -> Array:
        distance = np.arange(n)[:, None] - np.arange(n)
        return np.exp(-(distance**2) / (2 * prior.length_nodes**2))

    scalar = np.kron(kernel(slab.n_y), kernel(slab.n_x))
    return blocks_from_dense(bases, np.kron(scalar, np.diag(np.square(prior.sigma_n))))


def depth_modes(slab: Slab, noise: Noise) -> Array:
    """Columns: u_z patterns of one standard deviation that the images cannot tell, (3 n, 3)."""
    x = np.tile(np.linspace(-1, 1, slab.n_x), slab.n_y)
    y = np.repeat(np.linspace(-1, 1, slab.n_y), slab.n_x)
    modes = np.zeros((slab.n_nodes, 3, 3))
    modes[:, 2, 0] = noise.gauge_m
    modes[:, 2, 1] = noise.tilt_m * x
    modes[:, 2, 2] = noise.tilt_m * y
    return modes.reshape(-1, 3)


def observed_nodes(slab: Slab, window_m: tuple[float, float, float, float]) -> tuple[slice, slice]:
    """Node rows and columns inside the window (min_x, min_y, max_x, max_y from the pad's corner).

    Raises
    ------
    InputError
        When fewer than 2 x 2 nodes are inside.
    """
    slices = []
    for n, step, low, high in (
        (slab.n_y, slab.step_m[1], window_m[1], window_m[3]),
        (slab.n_x, slab.step_m[0], window_m[0], window_m[2]),
    ):
        tolerance = 1e-6 * step
        first = max(0, int(np.ceil((low - tolerance) / step)))
        last = min(n - 1, int(np.floor((high + tolerance) / step)))
        if last - first < 1:
            raise InputError(
                f"the observed window {window_m} m holds fewer than 2 node lines: "
                "widen [window] or refine [grid] in board.toml"
            )
        slices.append(slice(first, last + 1))
    return slices[0], slices[1]


def force_operator(
    slab: Slab,
    method: str,
    *,
    noise: Noise,
    ridge_weight: float = 1e-4,
    prior: ForcePrior | None = None,
    window_m: tuple[float, float, float, float] | None = None,
    progress: Progress = lambda _: None,
) -> Array:
    """G of the observed nodes, (3 m, 3 m), newton per metre.

    What lies outside the window is not seen. The papers' methods take it as free of force: U_o = C_oo F_o, so
    F_o = C_oo^-1 U_o. "optimal" estimates it with the same prior as the rest and does not report it:
    F_o = P_oa C_oa^T (C_oa P C_oa^T + R)^-1 U_o, o the observed and a all unknowns.

    Raises
    ------
    InputError
        Unknown method, or a negative or non-finite ridge weight.
    """
    if method not in METHODS:
        raise InputError(f"unknown method {method!r}: choose one of {', '.join(METHODS)}")
    if not (np.isfinite(ridge_weight) and ridge_weight >= 0):
        raise InputError(f"the ridge weight must be finite and not negative, got {ridge_weight}")
    condensed = condense(slab, progress=lambda done: progress(0.7 * done))
    seen = np.ones(3 * slab.n_nodes, dtype=bool)
    if window_m is not None:
        inside = np.zeros((slab.n_y, slab.n_x), dtype=bool)
        inside[observed_nodes(slab, window_m)] = True
        seen = np.repeat(inside.ravel(), 3)
    if method == "optimal":
        operator = _optimal(condensed, noise, prior or ForcePrior(), seen)
    else:
        blocks = ridge_operator(condensed, ridge_weight if method == "ridge" else 0.0)
        operator = _restrict(dense_from_blocks(condensed.bases, blocks), seen)
    progress(1.0)
    return operator


def _optimal(condensed: CondensedSlab, noise: Noise, prior: ForcePrior, seen: npt.NDArray[np.bool_]) -> Array:
    """In parity classes where the camera sees the whole pad, densely over the seen unknowns otherwise."""
    if seen.all():
        return dense_from_blocks(condensed.bases, optimal_operator(condensed, noise, prior))
    slab, bases = condensed.slab, condensed.bases
    compliance = dense_from_blocks(bases, [spd_inverse(b) for b in surface_stiffness(condensed)])[seen]
    covariance = dense_from_blocks(bases, _prior_blocks(slab, bases, prior))
    modes = depth_modes(slab, noise)[seen]
    r = np.diag(np.tile(np.square(noise.sigma_m), slab.n_nodes)[seen]) + modes @ modes.T
    cause = compliance @ covariance
    return np.asarray(la.solve(cause @ compliance.T + r, cause[:, seen], assume_a="pos").T)


def hidden_modes(
    condensed: CondensedSlab, compliance: Array, seen: npt.NDArray[np.bool_], prior: ForcePrior | None = None
) -> Array:
    """What forces outside the window do to the seen displacement: columns of one standard deviation, (m, hidden)."""
    if seen.all():
        return np.zeros((len(seen), 0))
    covariance = dense_from_blocks(
        condensed.bases, _prior_blocks(condensed.slab, condensed.bases, prior or ForcePrior())
    )
    spread = la.cholesky(covariance[np.ix_(~seen, ~seen)], lower=True)
    return np.asarray(compliance[np.ix_(seen, ~seen)] @ spread)


def _restrict(full: Array, seen: npt.NDArray[np.bool_]) -> Array:
    """Hidden nodes are free of force: eliminate their displacement."""
    if seen.all():
        return full
    hidden = ~seen
    coupling = full[np.ix_(seen, hidden)]
    return np.asarray(
        full[np.ix_(seen, seen)] - coupling @ la.solve(full[np.ix_(hidden, hidden)], coupling.T, assume_a="sym")
    )
