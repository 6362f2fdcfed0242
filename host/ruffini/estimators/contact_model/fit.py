"""Depth, area, kind and hardness out of a flow's profile: kind `contact_model` of proto/CALIBRATION.md.

firmware/stages/contact_model/contact_model.h has the equations. What is fitted, each by perceptrons of ten units (the
mean of N_SEEDS of them, side by side):

    size       gel and press depth over the profile's size, roots of contact and effective area; of every shape
    kind       1 of planar contact, -1 of Hertzian; over a press, with how force and radius grow with the profile's
               size, it makes log odds (`contact_tables`)
    fails      1 of presses for which no model holds (faces with gaps, objects softer than the gel), 0 of the others
    hardness   Shore A of planar and of Hertzian contact, on frames in the depths where the board measures it

The fit sees each frame also about middles a little beside the one that was found. Gel depth and area of the contact
are what the log says of them: the twin has them of every press (SIMULATED). Of a bench they are the travel of its stage
less what the object gives way under the force, and the indenter's face (`Press.known_gel_mm`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.contact_model.log import Press
from ruffini.estimators.contact_model.perceptron import Perceptron
from ruffini.estimators.contact_model.profile import N_RINGS, radial_um
from ruffini.estimators.contact_model.wrench import ContactWrench, fit_contact_wrench, reference_of

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

INPUT_STEP = np.array([2.0**-14] * N_RINGS + [2.0**-10] * 2)
LEAST_MM, MOST_MM = 0.4, 1.8  # where the board measures hardness
STRAIGHT = 0.1  # F_t over F_n of a press whose hardness counts
LEAST_SIZE_UM = 20.0  # of a profile: below nothing is learned
N_BESIDE, BESIDE_UM = 4, 250.0  # middles beside the one found, standard deviation
FORCE_NOISE = 0.01  # of the normal force there
N_SEEDS = 3
FAILS_UNITS, FAILS_DECAY = 12, 3e-3
SIZE_DECAY, HARDNESS_DECAY = 1e-4, 1e-2  # of the weights: by errors on sizes that were left out


@dataclass(frozen=True)
class Seen:
    """Inputs (t, 18) of a press' frames as the board makes them, profile size (t,) mm, and the frame of each row."""

    x: Array
    size_mm: Array
    frame: npt.NDArray[np.intp]


@dataclass(frozen=True)
class Model:
    """What a board needs, in float."""

    wrench: ContactWrench
    size: Perceptron
    kind: Perceptron
    fails: Perceptron
    hardness: tuple[Perceptron, Perceptron]
    mean: Array
    whitening: Array

    def sizes(self, seen: Seen) -> Array:
        """(t, 4) mm: gel depth, press depth, roots of area and effective area."""
        y = self.size(seen.x)
        y[:, :2] *= seen.size_mm[:, None]
        return np.asarray(y)

    def strange(self, x: Array) -> Array:
        """Mean square of the whitened profile, (t,)."""
        return np.asarray((((x[:, :N_RINGS] - self.mean) @ self.whitening.T) ** 2).mean(axis=1))


@dataclass(frozen=True)
class Told:
    """A press as a model tells it: signs of its kind, Shore A by either kind, strange, fails; NaN of too few frames.

    signs (3,) : mean of `kind`, slopes of log2 force and of log2 mean radius over log2 of the profile's size.
    """

    signs: Array
    shore: tuple[float, float]
    strange: float
    fails: float = np.nan

    @property
    def is_told(self) -> bool:
        """Whether there were frames enough."""
        return bool(np.isfinite(self.strange))


def inputs_of(radial_q4: Array, size_q4: Array, press_n: Array) -> Array:
    """x (t, 18) of profiles in 1/16 um and forces in N."""
    size = np.maximum(size_q4, 1.0)
    force = np.log2(np.maximum(press_n * 1e3, 1.0))
    return np.column_stack([radial_q4 / size[:, None], np.log2(size), force])


def seen_of(press: Press, press_n: Array) -> Seen:
    """The frames of a press that say anything."""
    at = np.flatnonzero(press.is_good & (press.size > 16 * LEAST_SIZE_UM))
    x = inputs_of(press.radial[at].astype(np.float64), press.size[at].astype(np.float64), press_n[at])
    return Seen(x, press.size[at] * 1e-3 / 16, at)


def beside(board: Board, press: Press, press_n: Array, rng: np.random.Generator) -> Seen:
    """The same frames, and N_BESIDE times about middles beside."""
    plain = seen_of(press, press_n)
    parts = [plain]
    for _ in range(N_BESIDE):
        at = plain.frame
        middle = press.center_um[at] + rng.normal(size=(len(at), 2)) * BESIDE_UM
        radial = radial_um(board, press.flow[at], middle) * 16
        size = np.sqrt((radial**2).sum(axis=1))
        force = press_n[at] * (1 + rng.normal(size=len(at)) * FORCE_NOISE)
        parts.append(Seen(inputs_of(radial, size, force), size * 1e-3 / 16, at))
    return Seen(*(np.concatenate([getattr(p, name) for p in parts]) for name in ("x", "size_mm", "frame")))


def is_measured(press: Press, frame: npt.NDArray[np.intp]) -> Bools:
    """Which frames count for hardness: by the log's gel depth, loaded straight."""
    force = press.force[frame]
    straight = np.hypot(force[:, 0], force[:, 1]) <= STRAIGHT * np.abs(force[:, 2]) + 1.0  # and the reference's errors
    depth = press.known_gel_mm[frame]
    return np.asarray((depth > LEAST_MM) & (depth < MOST_MM) & straight)


def seen_all(board: Board, presses: list[Press], wrench: ContactWrench) -> list[Seen]:
    """Each press with its middles beside."""
    rng = np.random.default_rng(0)
    return [beside(board, p, -wrench(p.flow)[:, 2], rng) for p in presses]


@dataclass(frozen=True)
class Log:
    """Presses with what the board sees of them: those of ordinary objects, and those for which no model holds."""

    presses: list[Press]
    seen: list[Seen]
    failing: list[Press]
    failing_seen: list[Seen]

    @classmethod
    def of(cls, board: Board, presses: list[Press]) -> Log:
        """By `Press.has_model`."""
        known, failing = ([p for p in presses if p.has_model == on] for on in (True, False))
        wrench = fit_contact_wrench(board, known)
        return cls(known, seen_all(board, known, wrench), failing, seen_all(board, failing, wrench))

    def without(self, is_left: Callable[[Press], bool]) -> Log:
        """What is not left out."""

        def kept(presses: list[Press], seen: list[Seen]) -> tuple[list[Press], list[Seen]]:
            at = [i for i, press in enumerate(presses) if not is_left(press)]
            return [presses[i] for i in at], [seen[i] for i in at]

        return Log(*kept(self.presses, self.seen), *kept(self.failing, self.failing_seen))


def fit_fails(log: Log, n_seeds: int = N_SEEDS) -> Perceptron:
    """1 of presses for which no model holds, 0 of the others; both count alike."""
    x, y = [], []
    for presses, seen, value in ((log.presses, log.seen, 0.0), (log.failing, log.failing_seen, 1.0)):
        for press, one in zip(presses, seen, strict=True):
            used = is_measured(press, one.frame)
            x.append(one.x[used])
            y.append(np.full((int(used.sum()), 1), value))
    inputs, aim = np.concatenate(x), np.concatenate(y)
    share = float(np.clip(aim.mean(), 1e-3, 1 - 1e-3))
    weights = np.sqrt(np.where(aim > 0, (1 - share) / share, 1.0))
    return Perceptron.mean_of(
        [
            Perceptron.fit(inputs, aim, weights=weights, decay=FAILS_DECAY, n_units=FAILS_UNITS, seed=seed)
            for seed in range(n_seeds)
        ]
    )


def fit_model(board: Board, log: Log, *, n_seeds: int = N_SEEDS) -> Model:
    """Fit everything.

    Raises
    ------
    InputError
        Neither planar nor Hertzian presses.
    """
    presses, seen = log.presses, log.seen
    if not any(p.is_hertzian for p in presses) or all(p.is_hertzian for p in presses):
        raise InputError("the log must hold presses of planar indenters and of balls: hardness needs both")
    wrench = fit_contact_wrench(board, presses)
    both = list(zip(presses, seen, strict=True))
    x = np.concatenate([s.x for s in seen])
    valid = np.concatenate([is_measured(p, s.frame) for p, s in both])
    is_flat = np.concatenate([np.full(len(s.frame), not p.is_hertzian) for p, s in both])
    shore = np.concatenate([np.full(len(s.frame), p.shore_a) for p, s in both])

    def mean(rows: Bools, y: Array, decay: float, weights: Array | None = None) -> Perceptron:
        return Perceptron.mean_of(
            [Perceptron.fit(x[rows], y, weights=weights, decay=decay, seed=seed) for seed in range(n_seeds)]
        )

    scale = np.concatenate([s.size_mm for s in seen])
    scales = np.column_stack([scale, scale, np.ones((len(scale), 2))])
    sizes = np.concatenate([true_sizes(p)[s.frame] for p, s in both])
    size = mean(np.ones(len(x), np.bool_), sizes / scales, SIZE_DECAY, scales)
    kind = mean(valid, np.where(is_flat[valid], 1.0, -1.0)[:, None], HARDNESS_DECAY)
    planar, hertzian = (
        mean(valid & (is_flat == on), shore[valid & (is_flat == on), None], HARDNESS_DECAY) for on in (True, False)
    )
    profile = x[valid, :N_RINGS]
    middle = profile.mean(axis=0)
    fails = fit_fails(log, n_seeds)
    return Model(wrench, size, kind, fails, (planar, hertzian), middle, _whitening(profile - middle))


def true_sizes(press: Press) -> Array:
    """What the log says of gel depth, travel and roots of areas, (t, 4) mm."""
    return np.column_stack([press.known_gel_mm, press.travel_mm, np.sqrt(press.known_area_mm2),
                            np.sqrt(press.effective_area_mm2)])  # fmt: skip


def _whitening(off: Array) -> Array:
    """(16, 16): of a profile less the mean, numbers that are independent and of spread one in the log."""
    values, axes = np.linalg.eigh(off.T @ off / len(off))
    return np.asarray((axes / np.sqrt(np.maximum(values, 1e-6 * values.max()))).T)


def tell(press: Press, model: Model) -> Told:
    """Mean over the frames that count, weighted by the depth as the board weighs them."""
    force = model.wrench(press.flow)
    seen = seen_of(press, -force[:, 2])
    depth = model.sizes(seen)[:, 0]
    at = seen.frame
    straight = np.hypot(force[at, 0], force[at, 1]) <= -STRAIGHT * force[at, 2]
    used = (depth >= LEAST_MM) & (depth <= MOST_MM) & straight & (depth > np.maximum.accumulate(depth) - 0.05)
    if used.sum() < 3:
        return Told(np.full(3, np.nan), (np.nan, np.nan), np.nan)
    weight, x = depth[used] / depth[used].sum(), seen.x[used]
    shore = [float(weight @ net(x)[:, 0].clip(0, 100)) for net in model.hardness]
    out = np.maximum(x[:, :N_RINGS], 0.0)
    radius = np.log2(np.maximum(out @ np.arange(1, N_RINGS + 1) / out.sum(axis=1), 1e-6))
    at = x[:, N_RINGS] - x[:, N_RINGS].mean()
    slopes = [float(at @ y / max(at @ at, 1e-12)) for y in (x[:, N_RINGS + 1], radius)]
    signs = np.array([float(weight @ model.kind(x)[:, 0]), *slopes])
    return Told(signs, (shore[0], shore[1]), float(weight @ model.strange(x)), float(weight @ model.fails(x)[:, 0]))


def errors(press: Press, model: Model) -> tuple[Array, Array]:
    """Of the good frames: wrench (t, 6) N and N mm against the reference less its crosstalk, sizes (t, 4) mm."""
    reference = reference_of(press)
    reference = reference - np.outer(reference[:, 2], model.wrench.crosstalk)
    force = model.wrench(press.flow)
    seen = seen_of(press, -force[:, 2])
    return force[press.is_good] - reference[press.is_good], model.sizes(seen) - true_sizes(press)[seen.frame]
