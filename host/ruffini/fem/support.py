"""Second pass: least squares on the contact's support, as tables for a few conjugate-gradient steps.

The linear estimate spreads a wrong material constant or depth constant over the whole pad as small
forces where nothing touches, and their sum is large. Once the support S of the contact is known,

    minimise over F_S   (u - C F)^T R^-1 (u - C F),   F = 0 outside S,

has no such freedom. R holds the white noise and, as modes of large variance, the depth's free
constant and tilt, so the data themselves settle these. Scaled to a unit diagonal, y = F / d, the
normal equations are H y = b with H = D C^T R^-1 C D and b = D C^T R^-1 u; a few conjugate-gradient steps
from the linear estimate solve what matters, and stopping early is the regularisation. Not in the
paper. The board runs it in integers (firmware/solve/support_solver.h).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.fem.condense import CondensedSlab, surface_stiffness
from ruffini.fem.operators import Noise, depth_modes
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]


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
    system: SupportSystem,
    displacement_m: Array,
    start_n: Array,
    support: npt.NDArray[np.bool_],
    *,
    n_steps: int,
) -> Array:
    """Float reference of the board's second pass.

    Parameters
    ----------
    displacement_m, start_n : (m,) float64
        Observed displacement; the linear estimate of the force.
    support : (m,) bool

    Returns
    -------
    (m,) float64
        Nodal force, newtons, zero outside the support.
    """
    index = np.flatnonzero(support)
    force = np.zeros_like(start_n)
    if not len(index):
        return force
    h = system.normal[np.ix_(index, index)]
    y = start_n[index] / system.scale_n[index]
    residual = system.project[index] @ displacement_m - h @ y
    direction = residual.copy()
    energy = residual @ residual
    for _ in range(n_steps):
        image = h @ direction
        curvature = direction @ image
        if curvature <= 0 or energy <= 0:
            break
        step = energy / curvature
        y += step * direction
        residual -= step * image
        previous, energy = energy, residual @ residual
        direction = residual + (energy / previous) * direction
    force[index] = y * system.scale_n[index]
    return force
