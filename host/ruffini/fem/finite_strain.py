"""Finite strain: the force that the linear model leaves out, from the displacement of the surface.

A neo-Hookean pad holds the surface displacement U with the forces f = K U + Q(U, U) + ... The inner displacement
is E U in the linear model, so by virtual work with H = grad(E U), p = -lambda tr H (Voigt's average over an element)

    Q(U, U) . V = int (-mu (H^T)^2 + p H^T) : grad(E V) + tr(H^2) / 2 p(E V)

What the second order moves inside the pad does no work on E V. E is that of 8-node bricks with B-bar as in `slab`,
on an endless layer: in waves along x and y (a cosine where the component is even at the mirror, a sine where it is
odd; mirrors stand MARGIN thicknesses outside the nodes) it is three numbers by three for each wave and plane. Three
element layers of 1 : 2 : 3 from the surface down, one integration point each. Pressure has its own table, so
nothing is lost as nu goes to 0.5.

Three layers of one point are coarse, and 1 mm deep in 4 mm the third order matters. A weight of each term in each
layer (FITTED) makes up for most of both, with the same tables and products on the board: fitted on presses of
`ruffini.sim`, proved on other shapes (tests/bench/large_strain.py, DESIGN.md).

Frame as everywhere: x right, y down, z out of the pad; node grids are (n_y, n_x, 3). Not in the papers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from ruffini.errors import InputError
from ruffini.fem.certificate import DISPLACEMENT_LSB_NM
from ruffini.fem.slab import Slab, assemble_layer

Array = npt.NDArray[np.float64]
Tensors = dict[str, npt.NDArray[np.generic]]

LAYERS = (1, 2, 3)  # thickness of the element layers from the surface, in sixths of the pad
MARGIN = 1.3  # from the nodes to the mirrors, in thicknesses of the pad: where a contact's field has died away
WAVES = 0.6  # of the waves that the nodes between the mirrors tell apart: products of more would alias
MAX_NODES = 63  # along x or y: the board's 32-bit sums
WAVE_SCALE = 1 << 11
LARGEST_16 = 32767
AREA_LIMIT = 1023  # of the areas and volumes by which an element's stress is multiplied
PLANE_STEP_M = DISPLACEMENT_LSB_NM * 1e-9 / 16  # of displacement inside the pad
GRADIENT_SCALE, SLOPE_SCALE = 1 << 13, 1 << 15
SIGN = np.array([(x, y, z) for z in (1, -1) for y in (-1, 1) for x in (-1, 1)], np.float64)  # corners as in `slab`


@dataclass(frozen=True)
class Weights:
    """Factors of the terms of Q in each layer, from the surface down; positive.

    square : of -mu (H^T)^2; pressure : of p H^T; volume : of tr(H^2) / 2 p(E V).
    """

    square: tuple[float, ...]
    pressure: tuple[float, ...]
    volume: tuple[float, ...]


EXACT = Weights(*(((1.0,) * len(LAYERS),) * 3))  # the second order, as these layers have it
# On a pad 6 node steps thick with nu = 0.48, presses of 0.6 to 1.5 mm. `tests/bench/large_strain.py --fit` prints them.
# On a pad 4.5 node steps thick they double the error (`fitted_weights`).
FITTED = Weights(square=(1.63, 0.89, 3.35), pressure=(0.90, 0.92, 1.59), volume=(0.85, 0.05, 1.42))

FITTED_STEPS, FITTED_POISSON = 6.0, 0.48
# Deviation up to which FITTED holds in full, and from which EXACT does: of the relative thickness, of Poisson's ratio.
STEPS_RANGE, POISSON_RANGE = (0.06, 0.2), (0.012, 0.03)


@dataclass(frozen=True)
class ErrorGrowth:
    """Variances over those of the error model's touches: of nodal shear, of nodal normal force and of the wrench.

    crosstalk: error of a contact's shear over its pressing force, in place of a smaller one of the touches.
    """

    shear: float
    normal: float
    wrench: float
    crosstalk: float


# A linear pad whose depth is seen: contacts of the twin err by other amounts than touches, whose edges are rounder. So
# that 95 % are within two sigma, in the geometric mean of four lists of contacts: tests/bench/faults_stated.py --lists.
LINEAR_GROWTH = ErrorGrowth(shear=1.44, normal=1.26, wrench=0.78, crosstalk=0.0)
# The error model's touches are linear; what the weights leave comes on top. From the same presses as FITTED, and by the
# same command, on one board: with the weights, checked on other shapes (tests/bench/faults_stated.py); with EXACT,
# not checked on a pad that goes by it.
FITTED_GROWTH = ErrorGrowth(shear=2.5, normal=2.7, wrench=1.2, crosstalk=1.7e-3)
UNWEIGHTED_GROWTH = ErrorGrowth(shear=4.7, normal=3.3, wrench=4.3, crosstalk=1.7e-3)


@dataclass(frozen=True)
class FiniteStrain:
    """Tables of Q for n_x x n_y nodes. P planes and P layers from the surface down, m_y x m_x waves.

    Attributes
    ----------
    step_m : (h_x, h_y) of the nodes; heights_m : (P,) of the layers; shear_pa : mu.
    cos_x, sin_x, mid_x : (m_x, n_x) twice, (m_x, n_x - 1): the waves at the nodes, at the elements' middles.
    cos_y, sin_y, mid_y : the same along y.
    extension : (P, m_y, m_x, 3, 3) a wave of the surface to that of a plane, with the wave's weight.
    pressure : (P, m_y, m_x, 3) a wave of the surface to p / mu of a layer, with the wave's weight, 1/m.
    weights : of the terms, in each layer.
    """

    step_m: tuple[float, float]
    heights_m: tuple[float, ...]
    shear_pa: float
    cos_x: Array
    sin_x: Array
    mid_x: Array
    cos_y: Array
    sin_y: Array
    mid_y: Array
    extension: Array
    pressure: Array
    weights: Weights

    def tensors(self, force_lsb_un: int) -> tuple[Tensors, dict[str, str]]:
        """What `kind` finite_strain holds (proto/CALIBRATION.md)."""
        extension, extension_shift = _to_16(self.extension)
        # The board forms b (p' H^T - (H^T)^2) and v' p'(E V): with p' = p a / b and v' = c b / a times the volume these
        # are the terms of weights b, a and c.
        b, a, c = (np.array(w) for w in (self.weights.square, self.weights.pressure, self.weights.volume))
        scaled = self.pressure * (a / b)[:, None, None, None]
        pressure, pressure_shift = _to_16(scaled * (DISPLACEMENT_LSB_NM * 1e-9))
        size = np.array([[*self.step_m, height] for height in self.heights_m])  # (P, 3)
        volume = size.prod(axis=1)
        area = b[:, None] * volume[:, None] / (4 * size)
        volume *= c * b / a
        area_step = area.max() / AREA_LIMIT
        # Both kinds of work in one unit: mu area_step / 2^10 per force, so the volume's step is a power of two of it.
        unit = 16 * area_step * DISPLACEMENT_LSB_NM * 1e-9
        volume_shift = int(np.ceil(np.log2(volume.max() / AREA_LIMIT / unit)))
        gain, gain_shift = _mantissa(self.shear_pa * area_step / 1024 / (force_lsb_un * 1e-6))
        integers = {
            "waves_x": len(self.cos_x), "waves_y": len(self.cos_y), "layers": len(self.heights_m),
            "extension_shift": extension_shift, "pressure_shift": pressure_shift, "volume_shift": volume_shift,
            "gain": gain, "gain_shift": gain_shift,
        }  # fmt: skip
        waves = {
            name: np.round(getattr(self, name) * WAVE_SCALE).astype(np.int16)
            for name in ("cos_x", "sin_x", "mid_x", "cos_y", "sin_y", "mid_y")
        }
        slope = np.round(GRADIENT_SCALE * PLANE_STEP_M * SLOPE_SCALE / (4 * size))
        tables = waves | {
            "extension": extension.transpose(0, 3, 4, 1, 2).astype(np.int16),
            "pressure": pressure.transpose(0, 3, 1, 2).astype(np.int16),
            "slope": slope.astype(np.int32),
            "area": np.round(area / area_step).astype(np.int32),
            "volume": np.round(volume / (unit * 2.0**volume_shift)).astype(np.int32),
        }
        named = {f"finite_strain.{name}": np.ascontiguousarray(table) for name, table in tables.items()}
        return named, {f"finite_strain.{name}": str(value) for name, value in integers.items()}

    def force(self, displacement_m: Array) -> Array:
        """Q(U, U) of nodes (n_y, n_x, 3) in metres: newtons on the nodes, to be ADDED to the linear K U.

        Double precision; firmware/solve/finite_strain.h does the same in integers.
        """
        wave = self._waves(displacement_m)
        planes = [self._at_nodes(np.einsum("yxij,yxj->yxi", e, wave)) for e in self.extension]
        planes.append(np.zeros_like(displacement_m))
        pressures = [self._at_middles(np.einsum("yxj,yxj->yx", p, wave)) for p in self.pressure]
        load = [np.zeros_like(displacement_m) for _ in planes]
        out = np.zeros_like(wave)
        for k, pressure in enumerate(pressures):
            upper, lower, square = self._layer(k, planes[k], planes[k + 1], pressure)
            load[k] += upper
            load[k + 1] += lower
            out += self.pressure[k] * (self.mid_y @ square @ self.mid_x.T)[..., None]
        for e, nodal in zip(self.extension, load[:-1], strict=True):
            out += np.einsum("yxij,yxi->yxj", e, self._waves(nodal))
        return self._at_nodes(out)

    def _layer(self, k: int, upper: Array, lower: Array, pressure: Array) -> tuple[Array, Array, Array]:
        """Nodal forces on a layer's two planes, and what multiplies p(E V), (n_y - 1, n_x - 1)."""
        size, weights = np.array([*self.step_m, self.heights_m[k]]), self.weights
        corners = np.stack(
            [_corner(plane, s) for plane, signs in ((upper, SIGN[:4]), (lower, SIGN[4:])) for s in signs]
        )
        h = np.einsum("nyxi,nj->yxij", corners, SIGN / (4 * size))
        turned = np.swapaxes(h, -1, -2)
        square = turned @ turned
        volume = self.shear_pa * size.prod()
        stress = volume * (weights.pressure[k] * pressure[..., None, None] * turned - weights.square[k] * square)
        nodal = np.einsum("yxij,nj->nyxi", stress, SIGN / (4 * size))
        halves = []
        for first in (0, 4):
            plane = np.zeros_like(upper)
            for n in range(first, first + 4):
                _corner(plane, SIGN[n])[...] += nodal[n]
            halves.append(plane)
        return halves[0], halves[1], weights.volume[k] * volume / 2 * np.trace(square, axis1=-2, axis2=-1)

    def _waves(self, f: Array) -> Array:
        x, y, z = f[..., 0], f[..., 1], f[..., 2]
        parts = [self.cos_y @ x @ self.sin_x.T, self.sin_y @ y @ self.cos_x.T, self.cos_y @ z @ self.cos_x.T]
        return np.stack(parts, axis=-1)

    def _at_nodes(self, a: Array) -> Array:
        x, y, z = a[..., 0], a[..., 1], a[..., 2]
        parts = [self.cos_y.T @ x @ self.sin_x, self.sin_y.T @ y @ self.cos_x, self.cos_y.T @ z @ self.cos_x]
        return np.stack(parts, axis=-1)

    def _at_middles(self, a: Array) -> Array:
        return np.asarray(self.mid_y.T @ a @ self.mid_x)


def _corner(plane: Array, sign: Array) -> Array:
    """The nodes (n_y - 1, n_x - 1, ...) at one corner of each element, a view."""
    y, x = (slice(1, None) if s > 0 else slice(None, -1) for s in (sign[1], sign[0]))
    return plane[y, x]


def fitted_weights(slab: Slab) -> Weights:
    """FITTED for pads like the one of the fit, EXACT for others, continuous between them."""
    share, terms = _share_fitted(slab), (FITTED.square, FITTED.pressure, FITTED.volume)
    return Weights(*(tuple(1 + share * (w - 1) for w in term) for term in terms))


def error_growth(slab: Slab) -> ErrorGrowth:
    """FITTED_GROWTH for pads like the one of the fit, UNWEIGHTED_GROWTH for others, continuous between them."""
    share = _share_fitted(slab)
    pairs = zip(vars(UNWEIGHTED_GROWTH).values(), vars(FITTED_GROWTH).values(), strict=True)
    return ErrorGrowth(*(exact + share * (fitted - exact) for exact, fitted in pairs))


def _share_fitted(slab: Slab) -> float:
    """1 for pads like the one of the fit, 0 for others."""
    h_x, h_y, _ = slab.step_m
    steps = slab.thickness_m / np.sqrt(h_x * h_y)
    deviation = (abs(steps / FITTED_STEPS - 1), abs(slab.poisson - FITTED_POISSON))
    return min(
        float(np.clip((lost - off) / (lost - kept), 0, 1))
        for off, (kept, lost) in zip(deviation, (STEPS_RANGE, POISSON_RANGE), strict=True)
    )


def finite_strain(slab: Slab, shape: tuple[int, int], weights: Weights | None = None) -> FiniteStrain:
    """Tables for the observed nodes (n_y, n_x) of a slab, which are its own or fewer; by default `fitted_weights`.

    Raises
    ------
    InputError
        More nodes than the board's sums hold.
    """
    h_x, h_y, _ = slab.step_m
    heights = tuple(slab.thickness_m * part / sum(LAYERS) for part in LAYERS)
    along_x = _Axis.build(shape[1], h_x, slab.thickness_m)
    along_y = _Axis.build(shape[0], h_y, slab.thickness_m)
    if max(*along_x.cos.shape, *along_y.cos.shape) > MAX_NODES:
        raise InputError(
            f"finite strain: {shape[1]} x {shape[0]} nodes need {len(along_x.cos)} x {len(along_y.cos)} waves, the "
            f"board's sums hold {MAX_NODES}: make [grid] coarser, or give --strain linear"
        )
    shear = slab.modulus_pa / (2 * (1 + slab.poisson))
    extension = _extension(slab, heights, along_x.angle, along_y.angle)
    weight = along_y.weight[:, None] * along_x.weight
    lame_over_shear = 2 * slab.poisson / (1 - 2 * slab.poisson)
    pressure = -lame_over_shear * _divergence(extension, heights, (h_x, h_y), along_x.angle, along_y.angle)
    return FiniteStrain(
        (h_x, h_y), heights, shear,
        along_x.cos, along_x.sin, along_x.mid, along_y.cos, along_y.sin, along_y.mid,
        extension[:-1] * weight[..., None, None], pressure * weight[..., None], weights or fitted_weights(slab),
    )  # fmt: skip


@dataclass(frozen=True)
class _Axis:
    """Waves along one axis: angle per node (m,), weight (m,), values at nodes and middles."""

    angle: Array
    weight: Array
    cos: Array
    sin: Array
    mid: Array

    @classmethod
    def build(cls, n: int, step: float, thickness: float) -> _Axis:
        margin = int(np.ceil(MARGIN * thickness / step))
        cells = n - 1 + 2 * margin
        number = np.arange(int(np.ceil(WAVES * (cells + 1))))
        angle = np.pi * number / cells
        place = margin + np.arange(n)
        at, between = angle[:, None] * place, angle[:, None] * (place[:-1] + 0.5)
        return cls(angle, np.where(number == 0, 1.0, 2.0) / cells, np.cos(at), np.sin(at), np.cos(between))


def _extension(slab: Slab, heights: tuple[float, ...], angle_x: Array, angle_y: Array) -> Array:
    """E of each plane, the bonded one last and zero, (P + 1, m_y, m_x, 3, 3)."""
    layers = [_symbols(slab, height, angle_x, angle_y) for height in heights]
    # A sine without waves is zero: its unknown is fixed by a stiffness of its own.
    fixed = np.zeros((len(angle_y), len(angle_x), 3))
    fixed[:, 0, 0] = fixed[0, :, 1] = np.abs(layers[0][0]).max()
    support = fixed[..., None] * np.eye(3)
    below = layers[-1][0] + support
    condensed = []
    for upper, lower, down, up in reversed(layers[:-1]):
        condensed.append((below + lower, up))
        below = upper + support - down @ np.linalg.solve(below + lower, up)
    planes: list[Array] = [np.broadcast_to(np.eye(3), below.shape)]
    for inner, up in reversed(condensed):
        planes.append(np.asarray(-np.linalg.solve(inner, up @ planes[-1])))
    return np.stack([*planes, np.zeros_like(below)])


def _symbols(slab: Slab, height: float, angle_x: Array, angle_y: Array) -> tuple[Array, Array, Array, Array]:
    """Stiffness of one element layer for waves: upper-upper, lower-lower, upper-lower, lower-upper."""
    h_x, h_y, _ = slab.step_m
    patch = replace(slab, n_x=3, n_y=3, n_layers=2, size_x_m=2 * h_x, size_y_m=2 * h_y, thickness_m=2 * height)
    layer = assemble_layer(patch)
    return (
        _symbol(layer.upper, angle_x, angle_y),
        _symbol(layer.lower, angle_x, angle_y),
        _symbol(layer.coupling, angle_x, angle_y),
        _symbol(layer.coupling.T.tocsr(), angle_x, angle_y),
    )


def _symbol(matrix: sp.csr_matrix, angle_x: Array, angle_y: Array) -> Array:
    """What the middle node of 3 x 3 feels of (sin cos, cos sin, cos cos) waves, (m_y, m_x, 3, 3)."""
    stencil = matrix.toarray().reshape(9, 3, 9, 3)[4]
    out = np.zeros((len(angle_y), len(angle_x), 3, 3), complex)
    for node in range(9):
        phase = angle_y[:, None] * (node // 3 - 1) + angle_x * (node % 3 - 1)
        out += np.exp(1j * phase)[..., None, None] * stencil[:, node]
    kind = np.array([-1j, -1j, 1.0])  # sines are odd
    return np.asarray((np.conj(kind)[:, None] * out * kind).real)


def _divergence(
    extension: Array, heights: tuple[float, ...], step: tuple[float, float], angle_x: Array, angle_y: Array
) -> Array:
    """Mean of div u over the elements of each layer, waves at their middles, (P, m_y, m_x, 3)."""
    half_x, half_y = angle_x / 2, angle_y[:, None] / 2
    along_x = 2 * np.sin(half_x) * np.cos(half_y) / step[0]
    along_y = 2 * np.cos(half_x) * np.sin(half_y) / step[1]
    both = np.cos(half_x) * np.cos(half_y)
    out = []
    for k, height in enumerate(heights):
        mean, rise = (extension[k] + extension[k + 1]) / 2, (extension[k] - extension[k + 1]) / height
        out.append(
            along_x[..., None] * mean[..., 0, :]
            + along_y[..., None] * mean[..., 1, :]
            + both[..., None] * rise[..., 2, :]
        )
    return np.stack(out)


def _to_16(table: Array) -> tuple[Array, int]:
    """table 2^shift, rounded, with the largest shift that fits 16 bits."""
    shift = int(np.floor(np.log2(LARGEST_16 / np.abs(table).max())))
    return np.round(table * 2.0**shift), shift


def _mantissa(value: float) -> tuple[int, int]:
    """value = mantissa / 2^shift with 15 bits."""
    shift = 15 - int(np.ceil(np.log2(value)))
    return min(round(value * 2.0**shift), LARGEST_16), shift
