"""How wrong the second pass is: a standard deviation for each nodal force, a covariance for the wrench.

What limits the second pass is not the noise but the edge of a contact between two nodes and a material that is not
quite the operator's, so no posterior of the noise tells it (DESIGN.md). A node's error is read off the field itself:

    variance_c = table_c[how large f_z is] + (reading_c + s^2) f_c^2 + step_c m_c^2 + w (contrast_c d_c^2 + rough_c r^2)

in force steps squared, one set of numbers for shear (x, y) and one for z. d is the difference from the mean of the
eight neighbours, m the largest difference from one of them, r^2 the mean of d_z^2 over the 7 x 7 nodes about it (large
under an edged contact, small under a ball), w = clamp(-f_z / T, 0, 1) as in the second pass. A node with no force takes
its variance from the largest pressure beside it and from m: what an edge, or far away a faint touch, may hide.

The wrench's error is, for each contact about its own centre of pressure, a constant part and a part proportional to the
pressing force (of a moment the lever: how far off the centre of pressure is; of shear the crosstalk), and for all
contacts together a common factor of the shear and one of the pressure. Beside these, the whole wrench w errs with the
pad's stiffness: s^2 w w^T is added. The fitted terms hold what a material known to 1 or 2 % makes, or one that was not
measured (`touches.MaterialSpread`), s what is known of this pad: the board's `stiffness_sigma_1e3`, or what `cal fit
--only material` leaves. The board does all of it in integers (firmware/solve/node_sigma.h,
firmware/estimators/wrench_covariance.h) and adds what filled nodes err by. Not in the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import maximum_filter, uniform_filter
from scipy.optimize import brentq, minimize

from ruffini.errors import InputError

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

REPORTED_LEVELS = 12  # bit widths 1..12 of |f_z| in steps, the last for all above
QUIET_LEVELS = 7  # of the largest |f_z| beside a node with none: bit widths in twos
LOCAL = ("reading", "contrast", "step", "rough")
ROUGH_NODES, ROUGH_SHARE = 7, 49 / 64  # the board adds up a square of nodes and divides by 64
AXIS_CLASS = (0, 0, 1)  # x and y share what they have learned

# The likelihood's tails: contacts err more often by far than a Gaussian allows.
STUDENT_FREEDOM = 5.0
STUDENT_CORE = 0.734  # its variance parameter for Gaussian errors of variance 1
SCALE_RANGE = 6.0  # of the last scaling, natural logarithm
AT_STAKE = 1 / 16  # of the threshold T: nodes with less true and less reported force than this are no evidence
FEWEST_SAMPLES = 20  # of a level; one with fewer takes the next one's variance
ONE_SIGMA, TWO_SIGMA = 0.6827, 0.9545


@dataclass(frozen=True)
class NodeError:
    """Variances in steps squared: `reported` (2, REPORTED_LEVELS), `quiet` (2, QUIET_LEVELS); LOCAL: `local` (2, 4)."""

    reported: Array
    quiet: Array
    local: Array


@dataclass(frozen=True)
class WrenchError:
    """Standard deviations of a contact's wrench about its centre of pressure.

    force_n : (2,) shear and normal, N; moment_nm : (2,) about x or y, and about z, N m
    lever_m : (2,) the same moments over the pressing force, m
    factor : (2,) common relative error of all shear, and of all pressure
    crosstalk : error of a contact's shear, x and y each, over its pressing force
    """

    force_n: Array
    moment_nm: Array
    lever_m: Array
    factor: Array
    crosstalk: float

    def report(self) -> dict[str, float | list[float]]:
        """As JSON holds it."""
        return {name: np.asarray(values).tolist() for name, values in vars(self).items()}


@dataclass(frozen=True)
class ContactLoad:
    """What the wrench's error needs of one contact: centre of pressure (2,) m, force (3,) N."""

    center_m: Array
    force_n: Array


@dataclass(frozen=True)
class NodeSample:
    """One touch in force steps: estimate and truth, (n_y, n_x, 3) each."""

    estimate: Array
    truth: Array


@dataclass(frozen=True)
class WrenchSample:
    """One touch with one contact: estimated wrench about its centre of pressure, and its error, (6,) N and N m."""

    wrench: Array
    error: Array


def node_sigma(model: NodeError, steps: Array, threshold_steps: float, stiffness_sigma: float = 0.0) -> Array:
    """Standard deviation of each nodal force, steps; of forces (n_y, n_x, 3) in whole steps."""
    design = [_design(steps, threshold_steps, c) for c in range(3)]
    values = [_parameters(model, k) for k in AXIS_CLASS]
    fitted = np.stack([d @ v for d, v in zip(design, values, strict=True)], axis=-1)
    return np.asarray(np.sqrt(fitted + (stiffness_sigma * steps) ** 2))


def wrench_covariance(
    model: WrenchError, wrench: Array, contacts: list[ContactLoad], stiffness_sigma: float = 0.0
) -> Array:
    """Covariance (6, 6) about the pad's centre, N and N m, of a wrench (6,) made by these contacts.

    Where nothing touches: what the error of one contact in the middle would be.
    """
    shear, pressure = wrench * [1, 1, 0, 0, 0, 1], wrench * [0, 0, 1, 1, 1, 0]
    total = model.factor[0] ** 2 * np.outer(shear, shear) + model.factor[1] ** 2 * np.outer(pressure, pressure)
    total += stiffness_sigma**2 * np.outer(wrench, wrench)
    for contact in contacts or [ContactLoad(np.zeros(2), np.zeros(3))]:
        transport = _transport(contact.center_m)
        total += transport @ np.diag(_own_variance(model, contact.force_n[2])) @ transport.T
    return np.asarray(total)


def _own_variance(model: WrenchError, force_z_n: float) -> Array:
    force = np.square(model.force_n)[[0, 0, 1]]
    force[:2] += (model.crosstalk * force_z_n) ** 2
    moment = (np.square(model.moment_nm) + np.square(model.lever_m * force_z_n))[[0, 0, 1]]
    return np.concatenate([force, moment])


def _transport(center_m: Array) -> Array:
    """Wrench about a point of the surface -> wrench about the pad's centre: t_0 = t + X x F."""
    x, y = center_m
    out = np.eye(6)
    out[3:, :3] = [[0, 0, y], [0, 0, -x], [-y, x, 0]]
    return out


def at_stake(sample: NodeSample, threshold_steps: float) -> Bools:
    """Nodes (n_y, n_x) that are evidence: with a true or a reported force above AT_STAKE of the threshold.

    Anywhere else nothing is reported and nothing is there: any sigma would cover an error of zero.
    """
    largest = np.maximum(np.abs(sample.estimate), np.abs(sample.truth)).max(axis=-1)
    return np.asarray(largest >= AT_STAKE * threshold_steps)


def fit_node_error(samples: list[NodeSample], threshold_steps: float) -> NodeError:
    """Maximum likelihood over the nodes at stake, then scaled until 68 and 95 % of the errors are covered.

    Raises
    ------
    InputError
        No sample touches the pad.
    """
    chosen = [at_stake(s, threshold_steps) for s in samples]
    if sum(int(c.sum()) for c in chosen) < 10 * FEWEST_SAMPLES:
        raise InputError(
            "the simulated touches press next to no node: is [contact] threshold_un above their forces? "
            "Without an error model (--touches 0) uncertainty is not measured"
        )
    parts = []
    for axes in ((0, 1), (2,)):
        design = np.concatenate(
            [_design(s.estimate, threshold_steps, c)[at] for c in axes for s, at in zip(samples, chosen, strict=True)]
        )
        error = np.concatenate(
            [(s.estimate - s.truth)[..., c][at] for c in axes for s, at in zip(samples, chosen, strict=True)]
        )
        parts.append(_fill(fit_variance(design, error), np.count_nonzero(design, axis=0)))
    both = np.array(parts)
    levels = REPORTED_LEVELS + QUIET_LEVELS
    return NodeError(both[:, :REPORTED_LEVELS], both[:, REPORTED_LEVELS:levels], both[:, levels:])


def fit_wrench_error(samples: list[WrenchSample]) -> WrenchError:
    """The same for wrenches of single contacts.

    Raises
    ------
    InputError
        Fewer than FEWEST_SAMPLES contacts.
    """
    if len(samples) < FEWEST_SAMPLES:
        raise InputError(
            f"{len(samples)} simulated touches make one contact: at least {FEWEST_SAMPLES} are needed, or --touches 0"
        )
    wrench, error = (np.array([getattr(s, name) for s in samples]) for name in ("wrench", "error"))
    one, none, pressing = np.ones(len(wrench)), np.zeros(len(wrench)), wrench[:, 2]

    def fit(axes: tuple[int, ...], unit: float, proportional: list[tuple[Array, ...]], known: Array = none) -> Array:
        design = np.concatenate([np.stack([unit * one, *parts], axis=1) ** 2 for parts in proportional])
        errors = np.concatenate([error[:, i] for i in axes])
        found = np.sqrt(fit_variance(design, errors, np.tile(known, len(axes))))
        return np.concatenate([[unit * found[0]], found[1:]])

    constant, factor, crosstalk = fit((0, 1), 1e-3, [(wrench[:, 0], pressing), (wrench[:, 1], pressing)])
    normal = fit((2,), 1e-3, [(pressing,)])
    bending = fit((3, 4), 1e-6, [(pressing,), (pressing,)])
    torsion = fit((5,), 1e-6, [(pressing,)], (factor * wrench[:, 5]) ** 2)
    force_n, factors = np.stack([[constant, factor], normal], axis=1)
    moment_nm, lever_m = np.stack([bending, torsion], axis=1)
    return WrenchError(force_n, moment_nm, lever_m, factors, float(crosstalk))


def fit_variance(design: Array, error: Array, known: Array | float = 0.0) -> Array:
    """Non-negative v with variance known + design @ v for errors of zero mean: Student likelihood, then scaled.

    The scale of v makes the quantiles of |error| / sigma at 68 and 95 % one and two in the geometric mean.
    """
    n = STUDENT_FREEDOM
    used = design.any(axis=0)
    columns, size = design[:, used], design[:, used].max(axis=0)
    columns = columns / size
    typical = float(np.mean(error**2))

    def loss(log_v: Array) -> tuple[float, Array]:
        v = np.exp(log_v)
        variance = STUDENT_CORE * known + columns @ v
        ratio = error**2 / variance
        value = 0.5 * np.log(variance) + (n + 1) / 2 * np.log1p(ratio / n)
        slope = (0.5 - (n + 1) / 2 * ratio / (n + ratio)) / variance
        return float(value.mean()), (columns * slope[:, None]).mean(axis=0) * v

    starts = [np.full(len(size), np.log(typical * part)) for part in (1.0, 1e-2)]
    low, high = np.log(typical * 1e-7), np.log(typical * 1e5)
    found = min(
        (minimize(loss, s, jac=True, method="L-BFGS-B", bounds=[(low, high)] * len(s)) for s in starts),
        key=lambda f: float(f.fun),
    )
    v = np.exp(found.x)

    def too_small(log_scale: float) -> float:
        relative = np.abs(error) / np.sqrt(known + np.exp(log_scale) * (columns @ v))
        return float(np.quantile(relative, ONE_SIGMA) * np.quantile(relative, TWO_SIGMA) / 2) - 1

    ends = (-SCALE_RANGE, SCALE_RANGE)
    # What is known may be too much already: then nothing is added.
    scale = 0.0 if too_small(ends[0]) <= 0 else np.exp(brentq(too_small, *ends))
    out = np.zeros(design.shape[1])
    out[used] = v / size * scale
    return out


def _parameters(model: NodeError, axis_class: int) -> Array:
    return np.concatenate([model.reported[axis_class], model.quiet[axis_class], model.local[axis_class]])


def _design(steps: Array, threshold_steps: float, axis: int) -> Array:
    """What the variance of each node is linear in, (n_y, n_x, levels + LOCAL)."""
    f, pressure = steps[..., axis], np.abs(steps[..., 2])
    level = np.minimum(_bit_width(pressure), REPORTED_LEVELS)
    beside = maximum_filter(pressure, size=3, mode="constant")
    quiet = np.minimum((_bit_width(beside) + 1) // 2, QUIET_LEVELS - 1)
    is_quiet = level == 0
    by_level = level[..., None] == np.arange(1, REPORTED_LEVELS + 1)
    by_quiet = is_quiet[..., None] & (quiet[..., None] == np.arange(QUIET_LEVELS))
    weight = np.clip(-steps[..., 2] / threshold_steps, 0, 1)
    contrast, rough = _contrast(f), _contrast(steps[..., 2]) ** 2
    rough = ROUGH_SHARE * uniform_filter(rough, size=ROUGH_NODES, mode="constant")
    lowest, highest = -maximum_filter(-np.pad(f, 1), size=3), maximum_filter(np.pad(f, 1), size=3)
    step = np.maximum(highest[1:-1, 1:-1] - f, f - lowest[1:-1, 1:-1])
    local = np.stack([f**2, weight * contrast**2, step**2, weight * rough], axis=-1)
    return np.concatenate([by_level, by_quiet, local], axis=-1)


def _contrast(f: Array) -> Array:
    """A plane of forces less the mean of the eight neighbours; beyond the grid there is none."""
    return np.asarray(f - (uniform_filter(f, size=3, mode="constant") * 9 - f) / 8)


def _bit_width(steps: Array) -> npt.NDArray[np.int64]:
    """Binary digits of whole numbers, 0 of 0."""
    return np.asarray(np.frexp(np.round(steps))[1], dtype=np.int64)


def _fill(values: Array, counts: npt.NDArray[np.int64]) -> Array:
    """Levels that the touches hardly reached take the nearest reached level's variance, the larger of two."""
    out = values.copy()
    for begin, end in ((0, REPORTED_LEVELS), (REPORTED_LEVELS, REPORTED_LEVELS + QUIET_LEVELS)):
        known = [i for i in range(begin, end) if counts[i] >= FEWEST_SAMPLES]
        for i in set(range(begin, end)) - set(known):
            nearest = min((abs(i - k) for k in known), default=0)
            out[i] = max((values[k] for k in known if abs(i - k) == nearest), default=values.max())
    return out
