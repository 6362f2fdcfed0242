"""Second pass: least squares on the contact's support, as tables for a few conjugate-gradient steps.

The linear estimate spreads a wrong material constant or depth constant over the whole pad as small
forces where nothing touches, and their sum is large. Once the support S of the contact is known,

    minimise over F_S   (u - C F)^T R^-1 (u - C F),   F = 0 outside S,

has no such freedom. R holds the white noise and, as modes of large variance, the depth's free
constant and tilt and what forces outside the camera's window do, so the data themselves settle these.
Scaled to a unit diagonal, y = F / d, the normal equations are H y = b with H = D C^T R^-1 C D and
b = D C^T R^-1 u.

Each node has a weight w in 0..1: how surely the linear estimate sees it touched. A round is two
conjugate-gradient steps from the present y, preconditioned by w^2 (a prior of standard deviation w);
before each later round w and y are multiplied by clamp(-f_z / T, 0, 1), T the contact threshold, so
that nodes which would pull lose their force and their freedom. Three rounds settle what matters, and
stopping early is the regularisation. The first round begins with the linear estimate made as large as explains b best:
under a wide contact that estimate takes most of the pressure for the depth's constant.

Shear is mostly noise but for a few patterns that every contact carries: pushed, twisted, spread, each
as large as the pressure, as the weight, or growing outwards. What the linear estimate has outside these
modes is shrunk by how much of it is noise (W. James and C. Stein, 1961), and the modes get a prior of
their own beside a smaller one of the single nodes' shear. All of it is continuous in u but for the number
of contacts. Not in the paper. The board runs it in integers (firmware/solve/support_solver.h, shear_modes.h).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.ndimage
from numpy.lib.stride_tricks import sliding_window_view

from ruffini.fem.condense import CondensedSlab, surface_stiffness
from ruffini.fem.operators import Noise, depth_modes, hidden_modes
from ruffini.reflection import dense_from_blocks, spd_inverse

Array = npt.NDArray[np.float64]

ROUNDS, STEPS = 3, 2
SQUARES = ((2, 1), (4, 4), (8, 16))  # side of a square of touched nodes, and the threshold over its own
STRONGEST = 8  # the strongest node over T, at most
MAX_CONTACTS = 8  # that have shear modes
SHEAR_WEIGHT = 0.5  # standard deviation of a node's shear against that of its pressure
MODE_GAIN = 2.0  # variance of a mode
NOISE_SHARE = 1.5  # expected noise that is taken off, over its mean: shrinks a little too much rather than too little
MOST_SIZE = 4.0  # by which the first round takes the linear estimate for larger or smaller
LEAST_SHARE = 1 / 32  # of a mode's square that must remain when it is made orthogonal


@dataclass(frozen=True)
class SupportSystem:
    """`normal` H (m, m) without unit, `project` D C^T R^-1 (m, m) newton^-1 times newton per metre,

    `scale_n` d (m,): force F = d y, newtons. m = 3 x observed nodes, xyz interleaved.
    `place_m` (m / 3, 2): where the nodes are. `shape`: rows and columns of nodes. `shear_noise`: standard
    deviation, in y, of the shear that the linear operator makes of white noise; 0 keeps all of its shear.
    """

    normal: Array
    project: Array
    scale_n: Array
    place_m: Array
    shape: tuple[int, int]
    shear_noise: float

    def evidence(self, rows: npt.NDArray[np.intp], displacement_m: Array, beyond_n: Array | None = None) -> Array:
        """Some rows of b of u + C Q: the displacement that a linear pad would have under the same forces.

        beyond_n: Q (m,), the finite-strain part of the force; K u is the linear part.
        """
        b = self.project[rows] @ displacement_m
        return b if beyond_n is None else b + self.normal[rows] @ (beyond_n / self.scale_n)


def support_system(
    condensed: CondensedSlab, noise: Noise, observed: npt.NDArray[np.bool_], linear: Array
) -> SupportSystem:
    """Normal equations over the observed unknowns (3 n,) bool.

    Forces on hidden nodes are not sought: what they do to the observed displacement is part of R, with the prior
    that "optimal" has. `linear` (m, m) N/m is the operator whose estimate the second pass starts from.
    """
    slab, bases = condensed.slab, condensed.bases
    white, nuisance = 1.0 / np.tile(np.square(noise.sigma_m), slab.n_nodes), depth_modes(slab, noise)
    compliances = [spd_inverse(b) for b in surface_stiffness(condensed)]
    information = white[observed]
    if observed.all():  # in parity classes: a sixteenth of the work
        parts = [
            _normal_equations(block, q.power(2).T @ white, q.T @ nuisance)
            for block, q in zip(compliances, bases, strict=True)
        ]
        project, normal = (dense_from_blocks(bases, list(blocks)) for blocks in zip(*parts, strict=True))
    else:
        whole = dense_from_blocks(bases, compliances)
        modes = np.hstack([nuisance[observed], hidden_modes(condensed, whole, observed)])
        project, normal = _normal_equations(whole[np.ix_(observed, observed)], information, modes)
    scale = 1.0 / np.sqrt(np.diag(normal))
    rows, columns = np.divmod(np.flatnonzero(observed[::3]), slab.n_x)
    place = np.stack([columns * slab.step_m[0], rows * slab.step_m[1]], axis=-1)
    shape = (len(np.unique(rows)), len(np.unique(columns)))
    deviation = np.sqrt(np.einsum("ij,ij,j->i", linear, linear, 1.0 / information)) / scale
    shear_noise = float(np.median(deviation.reshape(-1, 3)[:, :2]))
    normal *= scale  # in place: of these arrays, new memory takes longer than the products
    normal *= scale[:, None]
    project *= scale[:, None]
    return SupportSystem(normal, project, scale, place, shape, shear_noise)


def _normal_equations(compliance: Array, information: Array, modes: Array) -> tuple[Array, Array]:
    """C R^-1 and C R^-1 C for noise with 1 / `information` as white variance and columns of one deviation, `modes`."""
    # Woodbury: R^-1 = W - W V (I + V^T W V)^-1 V^T W for R = W^-1 + V V^T.
    weighted = information[:, None] * modes
    inner = np.linalg.inv(np.eye(modes.shape[1]) + modes.T @ weighted)
    project = compliance * information - (compliance @ weighted) @ inner @ weighted.T
    normal = project @ compliance
    return project, (normal + normal.T) / 2


def solve_on_support(
    system: SupportSystem, displacement_m: Array, start_n: Array, mask: Array, *, threshold_n: float,
    beyond_n: Array | None = None,
) -> Array:  # fmt: skip
    """Float reference of the board's second pass.

    Parameters
    ----------
    displacement_m, start_n : (m,) float64
        Observed displacement; the linear estimate of the force.
    mask : (m / 3,) float64
        `contact_mask` of the observed nodes.
    threshold_n : float
        T, above zero.
    beyond_n : (m,) float64, optional
        Finite-strain part of the force, which `start_n` already contains (`FiniteStrain.force`).

    Returns
    -------
    (m,) float64
        Nodal force, newtons, zero outside the mask.
    """
    nodes = np.flatnonzero(mask > 0)
    index = (3 * nodes[:, None] + np.arange(3)).ravel()
    contacts = _contacts(mask.reshape(system.shape), nodes)
    scale, b = system.scale_n[index].reshape(-1, 3), system.evidence(index, displacement_m, beyond_n).reshape(-1, 3)
    h = system.normal[np.ix_(index, index)]
    weight = mask[nodes, None]
    y = weight * start_n[index].reshape(-1, 3) / scale
    for i in range(ROUNDS):
        if i:
            keep = np.clip(-(y * scale)[:, 2:] / threshold_n, 0, 1)
            weight, y = weight * keep, y * keep
        modes = [(c, shear_modes(y[c], weight[c, 0], system.place_m[nodes[c]])) for c in contacts]
        if i == 0:
            for c, basis in modes:
                y[c, :2] = _shrunk(y[c, :2], basis, weight[c, 0], system.shear_noise)
            y = _size(y, b, h) * y
        y = _conjugate_gradients(h, b, y, weight, modes)
    force = np.zeros_like(start_n)
    force[index] = (y * scale).ravel()
    return force


def _contacts(mask: Array, nodes: npt.NDArray[np.intp]) -> list[npt.NDArray[np.intp]]:
    """Positions in `nodes` of each of the first contacts."""
    label, n = scipy.ndimage.label(mask > 0, structure=np.ones((3, 3)))
    return [np.flatnonzero(label.ravel()[nodes] == k) for k in range(1, min(n, MAX_CONTACTS) + 1)]


def shear_modes(y: Array, weight: Array, place_m: Array) -> Array:
    """Orthonormal shear patterns of one contact, (k, nodes, 2), k at most 12: see firmware/solve/shear_modes.h."""
    pressure = np.clip(-y[:, 2], 0, None)
    if not pressure.any():
        return np.zeros((0, len(y), 2))
    from_center = place_m - pressure @ place_m / pressure.sum()
    x, y_ = from_center.T
    one, zero = np.ones_like(x), np.zeros_like(x)
    ways = np.array([[one, zero], [zero, one], [-y_, x], [x, y_]]).transpose(0, 2, 1)
    amplitudes = np.array([pressure, weight, pressure * (x**2 + y_**2)])
    patterns = (amplitudes[:, None, :, None] * ways).reshape(12, -1)
    basis, k = np.empty_like(patterns), 0  # rows as they are found
    for vector in patterns:
        before = vector @ vector
        vector = vector - (basis[:k] @ vector) @ basis[:k]
        left = vector @ vector
        if left > 0 and left >= LEAST_SHARE * before:
            basis[k] = vector / np.sqrt(left)
            k += 1
    return np.asarray(basis[:k].reshape(k, len(y), 2))


def _projected(shear: Array, basis: Array) -> Array:
    """What the modes (k, nodes, 2) explain of `shear` (nodes, 2)."""
    rows = basis.reshape(len(basis), shear.size)
    return np.asarray(((rows @ shear.ravel()) @ rows).reshape(shear.shape))


def _shrunk(shear: Array, basis: Array, weight: Array, noise: float) -> Array:
    """`shear` (nodes, 2) with what no mode explains multiplied by 1 - E_noise / E_left."""
    left = shear - _projected(shear, basis)
    energy = np.sum(left**2)
    lost = min(NOISE_SHARE * 2 * np.sum(weight**2) * noise**2 / energy, 1.0) if energy > 0 else 0.0
    return np.asarray(shear - lost * left)


def _conjugate_gradients(
    h: Array, b: Array, y: Array, weight: Array, modes: list[tuple[npt.NDArray[np.intp], Array]]
) -> Array:
    """STEPS steps for H y = b from y (nodes, 3), preconditioned by weight squared and the shear modes."""

    def image_of(v: Array) -> Array:
        return np.asarray((h @ v.ravel()).reshape(v.shape))

    def precondition(r: Array) -> Array:
        z = (weight * np.array([SHEAR_WEIGHT, SHEAR_WEIGHT, 1.0])) ** 2 * r
        for c, basis in modes:
            z[c, :2] += MODE_GAIN * _projected(r[c, :2], basis)
        return np.asarray(z)

    residual = b - image_of(y)
    direction = precondition(residual)
    energy = np.sum(residual * direction)
    for _ in range(STEPS):
        image = image_of(direction)
        curvature = np.sum(direction * image)
        if curvature <= 0 or energy <= 0:
            break
        y = y + energy / curvature * direction
        residual = residual - energy / curvature * image
        z = precondition(residual)
        previous, energy = energy, np.sum(residual * z)
        direction = z + (energy / previous) * direction
    return y


def _size(y: Array, b: Array, h: Array) -> float:
    """How much of y explains b best."""
    explained, curvature = np.sum(y * b), np.sum(y.ravel() @ h @ y.ravel())
    return float(np.clip(explained / curvature, 1 / MOST_SIZE, MOST_SIZE)) if min(explained, curvature) > 0 else 1.0


def contact_mask(force_z_n: Array, *, threshold_n: float, min_nodes: int) -> tuple[Array, float]:
    """Where the pad is touched and how surely, (n_y, n_x), 0 to 1, and the smallest T: firmware/solve/contact_mask.h.

    How far the nodes are pressed beyond T, opened by squares of 2, 4 and 8 nodes, each with its own T, grown by one
    node; zero when fewer than `min_nodes` are opened.
    """
    pressure = np.maximum(-force_z_n, 0)
    opened, least_n = np.zeros_like(pressure), threshold_n
    for side, share in SQUARES:
        least_n = float(np.clip(pressure.max() / STRONGEST, threshold_n / share, threshold_n))
        if side > min(pressure.shape):
            continue
        smallest = sliding_window_view(pressure, (side, side)).min(axis=(2, 3))
        padded = np.pad(smallest, side - 1)
        largest = sliding_window_view(padded, (side, side)).max(axis=(2, 3))
        opened = np.maximum(opened, np.clip(largest / least_n - 1, 0, 1))
    if np.count_nonzero(opened) < min_nodes:
        opened = np.zeros_like(opened)
    return np.asarray(scipy.ndimage.maximum_filter(opened, size=3, mode="constant")), least_n
