"""What of a wrench is not linear in its features: landmarks of the log and a kernel of the distance to them.

Fitted together with K by robust least squares; firmware/stages/feature_wrench/kernel_map.h has the equations. Two
shapes are tried (`candidates`): a wide one that bends K a little, and a narrow one whose directions are weighted by how
fast the wrench changes along them (automatic relevance: largest marginal likelihood of a Gaussian process, of blocks of
touches), or, of few touches, which tell no relevance, a smooth one without K that allows for more noise. The narrow one
is the better where all kinds of touches were fitted, the wide one beyond their loads, the smooth one for objects that
were not fitted: which is used is decided by errors on what was left out (`kernel_choice`). Units here: N and N mm.

A dent changes the picture by as much wherever it is, so that for one kind of object the size of the change alone, |f|,
tells the normal force from few presses, whatever place they were at. That is a kernel with one landmark, rest, and a
curve fitted to the log (shapes "size"). The grid is blurred first: how a dent lies on its cells counts less then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import linalg
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize, nnls

from ruffini.calibrate.container import Tensors
from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Grid = tuple[int, int, int]

STEPS, LAST = 64, 16  # of the curve: entries a length, lengths
N_LANDMARKS = 1024  # KernelMap::kMaxLandmarks
N_DIRECTIONS = {"wide": 256, "narrow": 30, "smooth": 60}
WIDE_LENGTH, START_LENGTH = 3.0, 1.4  # of the spread of all features together
# The narrow one is a sum of Gaussians from 4 lengths down by halves, variance growing as length^2.5: the exponent with
# the largest likelihood of fitted touches of a real log. The longest is what remains far from all landmarks.
LONGEST, N_LENGTHS, GROWTH = 4.0, 5, 2.5
HALVED = tuple((LONGEST / 2**i, (LONGEST / 2**i) ** GROWTH) for i in range(N_LENGTHS))
GAUSSIAN = ((1.0, 1.0),)  # length and part
SIZES = {f"size {cells:g}": cells for cells in (0.5, 0.8)}  # standard deviation of the blur
SIZE_LENGTHS, MAX_SIZE = 8.0, 384  # largest |f| of the log in lengths, and KernelMap::kMaxDirections
LEAST_FRAMES = 200  # for any other
LEAST_TOUCHES = 50  # for relevance: fewer tell of no direction how fast the wrench changes along it
NOISE = 2e-3  # of the wide one: variance over that of the kernel
# Lengths and noises of the smooth one, of which what was left out of the fit chooses.
SMOOTH = {f"smooth {length:g} {noise:g}": (length, noise) for length in (2.0, 4.0, 8.0) for noise in (0.01, 0.1)}
LINEAR = 0.64  # variance of K's part over that of the kernel, at one spread
# Errors of neighbouring frames of a touch correlate by a half: there are a third as many independent ones.
INDEPENDENT = 1 / 3
TAIL = 4.0  # degrees of freedom of the errors: reference and tracker have outliers
N_PASSES = 4
N_BLOCK = 800  # frames whose likelihood is taken at once: time grows as its square
MAX_STEPS = 40
NOISES = np.geomspace(1e-5, 10, 120)  # of an axis, to choose from
ANY = 100.0  # variance of a constant over that of the kernel
LEAST_JITTER = 1e-7  # a curve that is straight between its entries is not quite positive definite
REACH_SHARE = 0.99  # of the frames left out that count as inside
PLACE, WEIGHT, CURVE = float(1 << 20), float(1 << 28), float(1 << 24)  # steps of the tables
MAX_ENTRY, MAX_SUM, MAX_SHIFT = 1 << 26, 1 << 36, 40
FINE, MICRO = 16e6, 1e6


@dataclass(frozen=True)
class Shape:
    """Where distances are measured: project (d, n) lengths a raw unit; curve (k,); noise (6,) and linear as above."""

    name: str
    project: Array
    curve: Array
    noise: Array
    linear: float
    spread: float  # of the features together, raw units
    is_of_size: bool = False  # its only landmark is rest

    def kernel(self, a: Array, b: Array) -> Array:
        """Of every row of `a` (t, d) with every one of `b`."""
        return np.asarray(np.interp(STEPS * distances(a, b), np.arange(len(self.curve)), self.curve))


@dataclass(frozen=True)
class KernelMap:
    """landmark (m, d) lengths, weight (6, m) and offset (6,) N and N mm; reach in lengths, spread in |u| a length."""

    shape: Shape
    landmark: Array
    weight: Array
    offset: Array
    reach: float = float(LAST)
    spread: float = 0.0

    def added(self, features: Array) -> Array:
        """What it adds to K f, (t, 6)."""
        k = self.shape.kernel(features @ self.shape.project.T, self.landmark)
        return np.asarray(k @ self.weight.T + self.offset)

    def nearest(self, features: Array) -> Array:
        """Distance to the nearest landmark (t,), lengths."""
        return np.asarray(distances(features @ self.shape.project.T, self.landmark).min(axis=1))


def distances(a: Array, b: Array) -> Array:
    """(t, m)."""
    square = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1) - 2 * a @ b.T
    return np.asarray(np.sqrt(np.maximum(square, 0)))


def shape_names(touch: npt.NDArray[np.intp], grid: Grid | None = None) -> list[str]:
    """The shapes to try on a log: of these touches, a number for each frame; of size only on a picture's grid."""
    size = list(SIZES) if grid is not None and np.prod(grid) <= MAX_SIZE else []
    if len(touch) < LEAST_FRAMES:
        return size
    return ["wide", "narrow", *size] if len(np.unique(touch)) >= LEAST_TOUCHES else ["wide", *SMOOTH, *size]


def candidates(
    features: Array, wrench: Array, touch: npt.NDArray[np.intp], names: Sequence[str] = ("wide", "narrow"),
    grid: Grid | None = None,
) -> list[Shape]:  # fmt: skip
    """The shapes to choose from, by name. grid : planes, rows and columns of a picture's features."""
    spread = float(np.sqrt(features.var(axis=0).sum()))
    found = {}
    if grid is not None:
        found = {name: _of_size(features, wrench, spread, SIZES[name], grid) for name in names if name in SIZES}
    if len(found) == len(names):
        return [found[name] for name in names]
    _, sizes, directions = np.linalg.svd((features - features.mean(axis=0)) / spread, full_matrices=False)
    gaussian, noise = _curve(GAUSSIAN), np.full(6, NOISE)
    wide = directions[: N_DIRECTIONS["wide"]] / (WIDE_LENGTH * spread)
    found["wide"] = Shape("wide", wide, gaussian, noise, LINEAR, spread)
    smooth = directions[: N_DIRECTIONS["smooth"]] / spread
    for name, (length, part) in SMOOTH.items():
        found[name] = Shape(name, smooth / length, gaussian, np.full(6, part), 0.0, spread)
    if "narrow" in names:
        narrow = directions[: min(N_DIRECTIONS["narrow"], int((sizes > 1e-9).sum()))]
        first = Shape("narrow", narrow / (START_LENGTH * spread), gaussian, noise, LINEAR, spread)
        weight = _solved(features, wrench, first)[2]
        lengths, noise_found, linear = _relevance(features @ narrow.T / spread, wrench, touch, weight)
        scaled = narrow / (lengths[:, None] * spread)
        found["narrow"] = Shape("narrow", scaled, _curve(HALVED), noise_found, linear, spread)
    return [found[name] for name in names]


def _of_size(features: Array, wrench: Array, spread: float, cells: float, grid: Grid) -> Shape:
    """A curve a |f| + b |f|^2 of the blurred f, a and b not negative: it rises beyond the log, too."""
    n = features.shape[1]
    blur = gaussian_filter(np.eye(n).reshape(n, *grid), (0, 0, cells, cells), mode="constant")
    project = np.asarray(blur.reshape(n, n), np.float64)  # symmetric
    size, force = np.linalg.norm(features @ project, axis=1), np.linalg.norm(wrench[:, :3], axis=1)
    length = max(float(size.max()) / SIZE_LENGTHS, 1e-9)
    r, one = size / length, np.ones(len(size))
    a, b = nnls(np.stack([r, r**2, one, -one], axis=1), force)[0][:2]
    distance = np.arange(STEPS * LAST + 1) / STEPS
    rise = a * distance + b * distance**2
    curve = np.round((1 - rise / max(rise[-1], 1e-12)) * CURVE) / CURVE
    return Shape(f"size {cells:g}", project / length, curve, np.full(6, NOISE), 0.0, spread, is_of_size=True)


def _curve(parts: tuple[tuple[float, float], ...]) -> Array:
    """As the table has it: what is fitted is what the board interpolates."""
    distance = np.arange(STEPS * LAST + 1) / STEPS
    bells = [part * np.exp(-((distance / length) ** 2) / 2) for length, part in parts]
    value = np.sum(bells, axis=0)
    return np.asarray(np.round(value / value[0] * CURVE) / CURVE)


class _Block(NamedTuple):
    """Frames of touches: directions x (n, d), wrench over its spread (n, 6), variance of noise (n,), x x^T (n, n)."""

    x: Array
    y: Array
    noisy: Array
    linear: Array


def _relevance(z: Array, wrench: Array, touch: npt.NDArray[np.intp], weight: Array) -> tuple[Array, Array, float]:
    """Length of each direction, noise (6,) and linear part: largest product of the likelihoods of blocks of touches.

    weight : of each frame; an outlier counts as so much noisier.
    """
    names = np.random.default_rng(0).permutation(np.unique(touch))
    y = (wrench - np.median(wrench, axis=0)) / np.maximum(wrench.std(axis=0), 1e-12)
    rows = [np.isin(touch, part) for part in np.array_split(names, max(round(len(touch) / N_BLOCK), 1))]
    blocks = [_Block(z[r], y[r], 1 / weight[r], z[r] @ z[r].T) for r in rows if r.any()]
    d = z.shape[1]
    start = np.r_[np.full(d, np.log(START_LENGTH)), np.log([1.0, LINEAR, 1e-3])]

    def unlikely(p: Array) -> tuple[float, Array]:
        off = p[:d] - np.log(START_LENGTH)
        value, slopes = 0.5 * float((off**2).sum()), np.r_[off, np.zeros(3)]
        for block in blocks:
            more, slope = _unlikely(p, block)
            value, slopes = value + more, slopes + slope
        return value, slopes

    try:
        p = minimize(unlikely, start, jac=True, method="L-BFGS-B", options={"maxiter": MAX_STEPS}).x
    except linalg.LinAlgError:  # features that repeat each other: as without relevance
        p = start
    size, slope = np.exp(p[d : d + 2])
    linear = float(slope / size)
    return np.exp(p[:d]), _noise(np.exp(-p[:d]), linear, blocks) / INDEPENDENT, linear


def _unlikely(p: Array, block: _Block) -> tuple[float, Array]:
    """Minus the logarithm of the likelihood, less a constant, and its slopes.

    p : logarithms of the lengths (d,), then of the variances of the kernel, of the linear part and of the noise.
    """
    x, y, noisy, linear = block
    d = x.shape[1]
    inverse, (size, slope, noise) = np.exp(-p[:d]), np.exp(p[d:])
    k, bent = (size * part for part in _bells(x * inverse))
    factor = linalg.cholesky(k + slope * linear + noise * np.diag(noisy), lower=True, check_finite=False)
    alpha = linalg.cho_solve((factor, True), y)
    lower = np.tril(linalg.lapack.dpotri(factor, lower=1)[0])
    m = 6 * (lower + np.tril(lower, -1).T) - alpha @ alpha.T
    mk = m * bent
    # Half the sum over i and j of mk_ij (x_ik - x_jk)^2, of every direction k at once.
    slopes = (mk.sum(axis=1) @ x**2 - (x * (mk @ x)).sum(axis=0)) * inverse**2
    rest = [0.5 * (m * k).sum(), 0.5 * slope * (m * linear).sum(), 0.5 * noise * (np.diag(m) * noisy).sum()]
    return float(0.5 * (y * alpha).sum() + 6 * np.log(np.diag(factor)).sum()), np.r_[slopes, rest]


def _bells(x: Array) -> tuple[Array, Array]:
    """The narrow curve's kernel (n, n) of places in lengths, and each of its parts over its length squared."""
    bell = np.exp(-0.5 * (distances(x, x) / LONGEST) ** 2)
    k, bent = np.zeros_like(bell), np.zeros_like(bell)
    total = sum(part for _, part in HALVED)
    for length, part in HALVED:
        k += part / total * bell
        bent += part / total / length**2 * bell
        bell = np.square(np.square(bell))  # of half the length
    return k, bent


def _noise(inverse: Array, linear: float, blocks: list[_Block]) -> Array:
    """Variance over that of the kernel, of each axis (6,): largest likelihood, whatever the kernel's own variance."""
    n, misfit, spread = 0, np.zeros((len(NOISES), 6)), np.zeros(len(NOISES))
    for block in blocks:
        root = 1 / np.sqrt(block.noisy)
        k = _bells(block.x * inverse)[0] + linear * block.linear + ANY
        values, axes = linalg.eigh(k * root[:, None] * root, driver="evd", check_finite=False)
        variance = np.maximum(values, 0) + NOISES[:, None]
        misfit += (1 / variance) @ (axes.T @ (block.y * root[:, None])) ** 2
        spread += np.log(variance).sum(axis=1)
        n += len(block.x)
    return np.asarray(NOISES[np.argmin(n * np.log(np.maximum(misfit, 1e-300)) + spread[:, None], axis=0)])


def solve(features: Array, wrench: Array, shape: Shape) -> tuple[Array, KernelMap]:
    """K (6, n) and the kernel beside it."""
    k, kernel, _ = _solved(features, wrench, shape)
    return k, kernel


def _solved(features: Array, wrench: Array, shape: Shape) -> tuple[Array, KernelMap, Array]:
    """As `solve`, and the weight of each frame (t,)."""
    z, x = features @ shape.project.T, features / shape.spread
    landmark = np.zeros((1, z.shape[1])) if shape.is_of_size else _landmarks(z, shape)
    middle, scale = np.median(wrench, axis=0), np.maximum(wrench.std(axis=0), 1e-12)
    factor = _factor(shape.kernel(landmark, landmark))
    basis = linalg.solve_triangular(factor, shape.kernel(landmark, z), lower=True).T
    columns = np.concatenate([basis, np.sqrt(shape.linear) * (x - x.mean(axis=0)), np.ones((len(x), 1))], axis=1)
    held = np.r_[np.ones(columns.shape[1] - 1), 0.0]  # by the ridge: all but the constant, and the curve of the size
    held[0] = not shape.is_of_size
    target, weight, found = (wrench - middle) / scale, np.ones(len(x)), np.zeros((columns.shape[1], 6))
    for _ in range(N_PASSES):
        weighted = columns * weight[:, None]
        square, product = weighted.T @ columns, weighted.T @ target
        for noise in np.unique(shape.noise):
            axes = shape.noise == noise
            found[:, axes] = linalg.solve(square + np.diag(noise * held + 1e-9), product[:, axes], assume_a="pos")
        left = columns @ found - target
        size = 1.4826 * np.median(np.abs(left), axis=0)
        weight = (TAIL + 1) / (TAIL + ((left / np.maximum(size, 1e-12)) ** 2).mean(axis=1))
    m = len(landmark)
    k = (np.sqrt(shape.linear) * found[m:-1] / shape.spread * scale).T
    weights = (linalg.solve_triangular(factor.T, found[:m], lower=False) * scale).T
    offset = middle + found[-1] * scale - k @ (x.mean(axis=0) * shape.spread)
    return np.asarray(k), KernelMap(shape, landmark, np.asarray(weights), np.asarray(offset)), weight


def _factor(kernel: Array) -> Array:
    """Lower triangle, with as little added to the diagonal as it takes."""
    jitter = LEAST_JITTER
    while True:
        try:
            return np.asarray(linalg.cholesky(kernel + jitter * np.eye(len(kernel)), lower=True))
        except linalg.LinAlgError:
            jitter *= 10


def _landmarks(z: Array, shape: Shape) -> Array:
    """Rows of z that the kernel knows least of from those before: pivoted Cholesky."""
    left, used = np.ones(len(z)), list[int]()
    rows = np.zeros((min(N_LANDMARKS, len(z)), len(z)))
    for j in range(len(rows)):
        i = int(np.argmax(left))
        if left[i] < 1e-6:
            break
        row = shape.kernel(z[i : i + 1], z)[0]
        rows[j] = (row - rows[:j, i] @ rows[:j]) / np.sqrt(left[i])
        left = np.maximum(left - rows[j] ** 2, 0)
        left[i] = 0
        used.append(i)
    return np.asarray(z[used])


def tables(found: KernelMap) -> Tensors:
    """Tensors wrench.kernel_*.

    Raises
    ------
    InputError
        A number does not fit them.
    """
    shape, shift = found.shape, np.zeros(7, np.uint8)
    largest = max(np.abs(shape.project).max(), np.abs(shape.project).sum(axis=1).max() * MAX_ENTRY / MAX_SUM) * PLACE
    shift[0] = _shift(MAX_ENTRY, largest)
    weight = np.zeros(found.weight.shape, np.int32)
    for i, row in enumerate(found.weight * FINE / CURVE):
        shift[1 + i] = _shift(WEIGHT, float(np.abs(row).max()))
        weight[i] = np.round(row * 2.0 ** shift[1 + i])
    if np.abs(found.offset * MICRO).max() >= 2**31 or np.abs(found.landmark).max() > 64:
        raise InputError("the kernel is beyond its table")
    return {
        "wrench.kernel_project": np.round(shape.project * PLACE * 2.0 ** shift[0]).astype(np.int32),
        "wrench.kernel_landmark": np.round(found.landmark * PLACE).astype(np.int32),
        "wrench.kernel_weight": weight,
        "wrench.kernel_curve": np.round(shape.curve * CURVE).astype(np.int32),
        "wrench.kernel_offset": np.round(found.offset * MICRO).astype(np.int32),
        "wrench.kernel_reach": np.array([min(found.reach * PLACE, 2**31 - 1), min(found.spread * 256, 1 << 16)],
                                        np.float64).round().astype(np.int32),
        "wrench.kernel_shift": shift,
    }  # fmt: skip


def _shift(limit: float, largest: float) -> int:
    shift = int(np.floor(np.log2(limit / max(largest, 1e-30)) - 1e-9))
    if shift < 1:
        raise InputError("the kernel is beyond its table")
    return min(shift, MAX_SHIFT)


def map_in(t: dict[str, Array]) -> KernelMap | None:
    """The kernel of tables without the prefix `wrench.`, in float."""
    if "kernel_curve" not in t:
        return None
    shift = t["kernel_shift"]
    shape = Shape("", t["kernel_project"] / (PLACE * 2.0 ** shift[0]), t["kernel_curve"] / CURVE, np.zeros(6), 0.0, 1.0)
    weight = t["kernel_weight"] * CURVE / (FINE * 2.0 ** shift[1:, None])
    reach, spread = t["kernel_reach"] / [PLACE, 256]
    return KernelMap(
        shape, t["kernel_landmark"] / PLACE, weight, t["kernel_offset"] / MICRO, float(reach), float(spread)
    )
