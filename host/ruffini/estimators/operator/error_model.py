"""The error model of a board's second pass, fitted on simulated touches: `support.error_*` of proto/CALIBRATION.md."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter, label
from threadpoolctl import threadpool_limits

from ruffini.errors import InputError
from ruffini.fem.finite_strain import ErrorGrowth
from ruffini.fem.operators import LONG_NODES, Noise
from ruffini.fem.slab import Slab
from ruffini.fem.touches import MaterialSpread, Touch, TouchMaker
from ruffini.fem.uncertainty import (
    NodeError,
    NodeSample,
    WrenchError,
    WrenchSample,
    fit_node_error,
    fit_wrench_error,
)

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
# Displacement (n_y, n_x, 3) m of the observed nodes -> force (n_y, n_x, 3) N and contact mask (n_y, n_x).
Estimate = Callable[[Array], tuple[Array, Array]]

# Displacement (n_y, n_x, 3) m of all of the pad's nodes -> that of the observed ones as the board would find it.
Observe = Callable[[Array, np.random.Generator], Array]

Tensors = dict[str, npt.NDArray[np.generic]]

# Scales and limits of firmware/solve/node_sigma.h and firmware/estimators/wrench_covariance.h.
VARIANCE_Q8, VARIANCE_RANGE = 1 << 8, (1 << 8, (1 << 31) - 1)
LOCAL_Q16, LARGEST_LOCAL = 1 << 16, 1 << 18
FACTOR_Q20 = 1 << 20
WRENCH_RANGES = ((100, 1 << 20), (100, 1 << 24), (0, 1 << 20), (0, 1 << 20))  # uN, uN mm, nm, Q20

FITTED = MaterialSpread()
N_TOUCHES = 120
SEED = 20_000
# Where the noise's correlation is not known: in every second touch so much noise of long correlation, over the white
# one's standard deviation, beside it, as a badly integrated depth has it.
CORRELATED_PART = 0.5


@dataclass(frozen=True)
class ErrorModel:
    """What the board needs to say how wrong it is."""

    node: NodeError
    wrench: WrenchError

    def grown(self, growth: ErrorGrowth) -> ErrorModel:
        """The same with larger variances; the wrench's are held as standard deviations."""
        factors = np.array([growth.shear, growth.normal])[:, None]
        node = NodeError(self.node.reported * factors, self.node.quiet * factors, self.node.local * factors)
        wrench = WrenchError(*(part * np.sqrt(growth.wrench) for part in vars(self.wrench).values()))
        return ErrorModel(node, replace(wrench, crosstalk=max(wrench.crosstalk, growth.crosstalk)))


@dataclass(frozen=True)
class NodePlaces:
    """The observed nodes: x (n_x,) and y (n_y,) from the pad's centre, metres."""

    x_m: Array
    y_m: Array

    def wrench(self, force: Array, center_m: Array) -> Array:
        """Force and moment of nodal forces (n_y, n_x, 3) about a point of the surface, (6,) N and N m."""
        x, y = self.x_m[None, :] - center_m[0], self.y_m[:, None] - center_m[1]
        fx, fy, fz = np.moveaxis(force, -1, 0)
        moment = [(y * fz).sum(), -(x * fz).sum(), (x * fy - y * fx).sum()]
        return np.array([*force.sum(axis=(0, 1)), *moment])

    def center_of_pressure(self, force_z: Array) -> Array | None:
        """(2,) m of the pressing nodes; None where none presses."""
        pressing = np.minimum(force_z, 0)
        total = float(pressing.sum())
        if total == 0:
            return None
        return np.array([(pressing * self.x_m[None, :]).sum(), (pressing * self.y_m[:, None]).sum()]) / total


def fit_error_model(
    slab: Slab,
    observed: tuple[slice, slice],
    estimate: Estimate,
    noise: Noise,
    *,
    force_step_n: float,
    threshold_n: float,
    n_touches: int = N_TOUCHES,
    observe: Observe | None = None,
    spread: MaterialSpread = FITTED,
    progress: Progress = lambda _: None,
) -> ErrorModel:
    """Press simulated pads, solve as the board would, fit what it gets wrong.

    `observe` takes the place of `noise` where displacement is not seen but estimated.

    Raises
    ------
    InputError
        Too few touches to fit, or a board that hardly feels them.
    """
    places = node_places(slab, observed)
    nodes: list[NodeSample] = []
    wrenches: list[WrenchSample] = []
    touches = _observations(slab, observed, observe, noise, n_touches, spread, lambda done: progress(0.6 * done))
    with threadpool_limits(limits=1):  # many small solves: more threads cost more than they give
        for i, (touch, u) in enumerate(touches):
            force, mask = estimate(u)
            force, truth = _round(force, force_step_n), touch.force[observed]
            nodes.append(NodeSample(force / force_step_n, _round(truth, force_step_n) / force_step_n))
            center = places.center_of_pressure(force[..., 2])
            if center is not None and label(mask > 0, np.ones((3, 3)))[1] == 1:
                wrenches.append(WrenchSample(places.wrench(force, center), places.wrench(force - truth, center)))
            progress(0.6 + 0.3 * (i + 1) / len(touches))
        return ErrorModel(fit_node_error(nodes, threshold_n / force_step_n), fit_wrench_error(wrenches))


def error_tensors(model: ErrorModel) -> Tensors:
    """The model as the board's integers, `support.error_*` of proto/CALIBRATION.md.

    Raises
    ------
    InputError
        A number is beyond what the board takes.
    """
    wrench = model.wrench
    rows = {
        "support.error_reported": (model.node.reported * VARIANCE_Q8, VARIANCE_RANGE),
        "support.error_quiet": (model.node.quiet * VARIANCE_Q8, VARIANCE_RANGE),
        "support.error_local": (model.node.local * LOCAL_Q16, (0, LARGEST_LOCAL)),
    }
    parts = (wrench.force_n * 1e6, wrench.moment_nm * 1e9, wrench.lever_m * 1e9, wrench.factor * FACTOR_Q20)
    tensors: Tensors = {name: _whole(name, values, *limits) for name, (values, limits) in rows.items()}
    lines = [_whole("support.error_wrench", p, *limits) for p, limits in zip(parts, WRENCH_RANGES, strict=True)]
    crosstalk = _whole("support.error_crosstalk", np.array([wrench.crosstalk]) * FACTOR_Q20, *WRENCH_RANGES[3])
    return {**tensors, "support.error_wrench": np.stack(lines), "support.error_crosstalk": crosstalk}


def _whole(name: str, values: Array, low: int, high: int) -> npt.NDArray[np.int32]:
    """Rounded; raised to what the board takes at least, refused above what it takes at most."""
    rounded = np.maximum(np.round(values), low)
    if not (rounded <= high).all():
        raise InputError(
            f"{name} reaches {rounded.max():.3g}, the board takes at most {high}: is [contact] threshold_un or "
            "[field] force_lsb_un far from this pad's forces?"
        )
    return rounded.astype(np.int32)


def node_places(slab: Slab, observed: tuple[slice, slice]) -> NodePlaces:
    """Places of a slab's observed nodes."""
    x = np.linspace(-0.5, 0.5, slab.n_x) * slab.size_x_m
    y = np.linspace(-0.5, 0.5, slab.n_y) * slab.size_y_m
    return NodePlaces(x[observed[1]], y[observed[0]])


def _round(force: Array, step_n: float) -> Array:
    return np.asarray(np.floor(force / step_n + 0.5) * step_n)


def _observations(
    slab: Slab, observed: tuple[slice, slice], observe: Observe | None, noise: Noise, n_touches: int,
    spread: MaterialSpread, progress: Progress,
) -> list[tuple[Touch, Array]]:  # fmt: skip
    """Touches of four pads off by the material's spread, and the displacement that the board would see."""
    rng = np.random.default_rng(SEED)
    pads, out = spread.pads(slab), []
    for i, pad in enumerate(pads):
        maker = TouchMaker(pad, SEED + i, modulus_spread=spread.modulus)
        for k in range(n_touches // len(pads)):
            touch = maker.draw()
            seen = touch.displacement[observed]
            if observe is None:
                seen = seen + _noise(rng, seen.shape, noise, may_be_white=k % 2 == 0)
            else:
                seen = observe(touch.displacement, rng)
            out.append((touch, seen))
        progress((i + 1) / len(pads))
    return out


def _noise(rng: np.random.Generator, shape: tuple[int, ...], noise: Noise, *, may_be_white: bool) -> Array:
    """Noise (n_y, n_x, 3) m as `noise` has it; if its correlation is not known, as CORRELATED_PART says."""
    smooth = gaussian_filter(rng.normal(size=shape), (LONG_NODES, LONG_NODES, 0), mode="reflect")
    smooth /= np.maximum(smooth.std(axis=(0, 1)), 1e-12)
    white = rng.normal(size=shape)
    if noise.long_share is None:
        unit = white + (0.0 if may_be_white else CORRELATED_PART) * smooth
    else:
        share = np.array(noise.long_share)
        unit = np.sqrt(1 - share) * white + np.sqrt(share) * smooth
    return np.asarray(unit * np.array(noise.sigma_m))
