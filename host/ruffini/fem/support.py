"""Second pass: least squares on the contact's support, as tables for a few conjugate-gradient steps.

The linear estimate spreads a wrong material constant or depth constant over the whole pad as small
forces where nothing touches, and their sum is large. Once the support S of the contact is known,

    minimise over F_S   (u - C F)^T R^-1 (u - C F),   F = 0 outside S,

has no such freedom. R holds the white noise and, as modes of large variance, the depth's free
constant and tilt, so the data themselves settle these. Scaled to a unit diagonal, y = F / d, the
normal equations are H y = b with H = D C^T R^-1 C D and b = D C^T R^-1 u.

Each node has a weight w in 0..1: how surely the linear estimate sees it touched. A round is two
conjugate-gradient steps from the present y, preconditioned by w^2 (a prior of standard deviation w);
before each later round w and y are multiplied by clamp(-f_z / T, 0, 1), T the contact threshold, so
that nodes which would pull lose their force and their freedom. Three rounds settle what matters, and
stopping early is the regularisation. All of it is continuous in u. Not in the paper. The board runs
it in integers (firmware/solve/support_solver.h).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage

from ruffini.fem.condense import CondensedSlab, surface_stiffness
from ruffini.fem.operators import Noise, depth_modes
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]

ROUNDS, STEPS = 3, 2


@dataclass(frozen=True)
class SupportSystem:
    """`normal` H (m, m) without unit, `project` D C^T R^-1 (m, m) newton^-1 times newton per metre,

    `scale_n` d (m,): force F = d y, newtons. m = 3 x observed nodes, xyz interleaved.
    """

    normal: Array
    project: Array
    scale_n: Array


def support_system(condensed: CondensedSlab, noise: Noise, observed: npt.NDArray[np.bool_]) -> SupportSystem:
    """Normal equations over the observed unknowns (3 n,) bool; hidden nodes carry no force.

    In the four parity classes where the whole pad is observed, densely otherwise.
    """
    slab = condensed.slab
    white = 1.0 / np.tile(np.square(noise.sigma_m), slab.n_nodes)
    compliance = dense_from_blocks(condensed.bases, [spd_inverse(b) for b in surface_stiffness(condensed)])[
        np.ix_(observed, observed)
    ]
    modes = depth_modes(slab, noise)[observed]
    information = white[observed]
    # Woodbury: R^-1 = W - W V (I + V^T W V)^-1 V^T W for R = W^-1 + V V^T.
    weighted = information[:, None] * modes
    inner = np.linalg.inv(np.eye(modes.shape[1]) + modes.T @ weighted)
    project = compliance * information - (compliance @ weighted) @ inner @ weighted.T
    normal = project @ compliance
    normal = (normal + normal.T) / 2
    scale = 1.0 / np.sqrt(np.diag(normal))
    return SupportSystem(normal * np.outer(scale, scale), project * scale[:, None], scale)


def solve_on_support(
    system: SupportSystem, displacement_m: Array, start_n: Array, mask: Array, *, threshold_n: float
) -> Array:
    """Float reference of the board's second pass.

    Parameters
    ----------
    displacement_m, start_n : (m,) float64
        Observed displacement; the linear estimate of the force.
    mask : (m / 3,) float64
        `contact_mask` of the observed nodes.
    threshold_n : float
        T, above zero.

    Returns
    -------
    (m,) float64
        Nodal force, newtons, zero outside the mask.
    """
    index = np.flatnonzero(np.repeat(mask > 0, 3))
    force = np.zeros_like(start_n)
    weight = np.repeat(mask, 3)[index]
    scale, b = system.scale_n[index], system.project[index] @ displacement_m
    h = system.normal[np.ix_(index, index)]
    y = weight * start_n[index] / scale
    for i in range(ROUNDS):
        if i:
            keep = np.repeat(np.clip(-(y * scale)[2::3] / threshold_n, 0, 1), 3)
            weight, y = weight * keep, y * keep
        y = _conjugate_gradients(h, b, y, weight)
    force[index] = y * scale
    return force


def _conjugate_gradients(h: Array, b: Array, y: Array, weight: Array) -> Array:
    """STEPS steps for H y = b from y, preconditioned by weight squared."""
    residual = b - h @ y
    direction = weight**2 * residual
    energy = np.sum((weight * residual) ** 2)
    for _ in range(STEPS):
        image = h @ direction
        curvature = direction @ image
        if curvature <= 0 or energy <= 0:
            break
        y = y + energy / curvature * direction
        residual = residual - energy / curvature * image
        previous, energy = energy, np.sum((weight * residual) ** 2)
        direction = weight**2 * residual + (energy / previous) * direction
    return y


def contact_mask(force_z_n: Array, *, threshold_n: float, min_nodes: int) -> Array:
    """Where the pad is touched and how surely, (n_y, n_x), 0 to 1: see firmware/solve/contact_mask.h.

    How far each node is pressed beyond the threshold, opened by 2 x 2 nodes, grown by one node; zero
    when fewer than `min_nodes` are opened.
    """
    pressed = np.clip(-force_z_n / threshold_n - 1, 0, 1)
    corners = (np.s_[1:, 1:], np.s_[:-1, 1:], np.s_[1:, :-1], np.s_[:-1, :-1])
    smallest = np.minimum.reduce([pressed[corner] for corner in corners])
    opened = np.zeros_like(pressed)
    for corner in corners:
        opened[corner] = np.maximum(opened[corner], smallest)
    if np.count_nonzero(opened) < min_nodes:
        return np.zeros_like(pressed)
    return np.asarray(scipy.ndimage.maximum_filter(opened, size=3, mode="constant"))
