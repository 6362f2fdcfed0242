"""How much force a pad loses under a held strain, and how fast, from a log of held touches with a reference wrench.

The board's estimate W_e is elastic. With the relaxation function 1 - sum g_k (1 - exp(-t / tau_k)) of the instantaneous
stiffness the wrench is

    W = a (W_e - sum g_k h_k),   tau_k dh_k/dt = W_e - h_k

(firmware/solve/relaxation.h, summed over the nodes). a > 1 takes the modulus from what it was fitted at, some time
after each touch began, to the instant. For given tau_k it is linear in a and a g_k: non-negative least squares for
every choice of at most MAX_TERMS of the times TIMES_S that the log can tell; the fewest terms that explain it as
well are kept.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import nnls

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile, Tensors
from ruffini.calibrate.log.reference import play, read_fit
from ruffini.errors import InputError
from ruffini.estimators.material.fit import LEVER_M, TOUCHED_N

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MAX_TERMS = 3
TIMES_S = (0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
AS_GOOD = 1.05  # residual (L2) of fewer terms over that of the best choice
ROUNDS = 3  # the dents that are left between touches depend on what is fitted
SHORTEST_S = 2.0
PART_Q20 = 2**20
MOST_BYTES = 1 << 27  # of the states that are stepped at once


@dataclass(frozen=True)
class RelaxationLog:
    """Times (t,) s, elastic estimate and reference wrench (t, 6) N and N m."""

    time_s: Array
    elastic: Array
    reference: Array


@dataclass(frozen=True)
class RelaxationFit:
    """`gain` a, terms (g_k, tau_k s), and the force RMSE (N) of the log before and after."""

    gain: float
    terms: tuple[tuple[float, float], ...]
    rmse_before_n: float
    rmse_after_n: float

    @property
    def loss(self) -> float:
        """Part of the instantaneous force that goes in the end."""
        return sum(g for g, _ in self.terms)

    def tensors(self) -> tuple[Tensors, dict[str, str]]:
        """The `relaxation` kind of a calibration file: tensors and metadata."""
        return {
            "relaxation.part": np.round(np.array([g for g, _ in self.terms]) * PART_Q20).astype(np.int32),
            "relaxation.time_ms": np.round(np.array([t for _, t in self.terms]) * 1e3).astype(np.int32),
        }, {"relaxation.terms": str(len(self.terms))}

    def text(self) -> str:
        """Its terms."""
        return "of the force at once goes " + ", ".join(f"{100 * g:.1f} % in {tau:g} s" for g, tau in self.terms)

    def report(self) -> dict[str, Any]:
        """What `ruffini cal fit --only relaxation` prints and writes."""
        return {
            "gain": self.gain, "loss": self.loss,
            "terms": [{"part": g, "time_s": tau} for g, tau in self.terms],
            "rmse_before_n": self.rmse_before_n, "rmse_after_n": self.rmse_after_n,
        }  # fmt: skip


def log_from_recording(
    board: Board, calibration: CalibrationFile, recording: Path, reference: Path | None, *, progress: Progress
) -> RelaxationLog:
    """The board's own estimate of every valid frame beside the reference; frames are one period of the board apart.

    Raises
    ------
    InputError
        The calibration already compensates relaxation, no reference, or no valid frame.
    """
    if "relaxation" in calibration.kinds:
        raise InputError(
            "this calibration already compensates relaxation: take one of `cal fit --only operator` without it"
        )
    played = play(board, calibration, recording, reference, lambda _, frame: frame.wrench, progress=progress)
    return RelaxationLog(played.frame * 1e3 / board.camera.rate_mhz, played.taken, played.wrench)


def fit_relaxation(log: RelaxationLog) -> RelaxationFit:
    """Fit gain and terms to a log.

    Raises
    ------
    InputError
        NaN, a log too short or without a held touch, or one that shows no relaxation.
    """
    if not (np.isfinite(log.reference).all() and np.isfinite(log.elastic).all()):
        raise InputError("the log holds NaN or infinity: cut these frames out")
    span = float(log.time_s[-1] - log.time_s[0])
    touched = np.linalg.norm(log.elastic[:, :3], axis=1) > TOUCHED_N
    held = float(np.diff(log.time_s)[touched[1:]].sum())
    if held < SHORTEST_S:
        raise InputError(
            f"the log is touched for {held:.1f} s in all: hold several touches for seconds each, "
            f"{SHORTEST_S} s at least"
        )
    period = float(np.median(np.diff(log.time_s)))
    times = [tau for tau in TIMES_S if 2 * period <= tau <= span]
    weight = np.array([1.0] * 3 + [1 / LEVER_M] * 3)
    target = (log.reference * weight).ravel()
    choices = []
    for n in range(1, MAX_TERMS + 1):
        ways = list(itertools.combinations(times, n))
        at_once = max(1, MOST_BYTES // (n * log.elastic.nbytes))
        for i in range(0, len(ways), at_once):
            some = ways[i : i + at_once]
            fits = _fit(log, touched, np.array(some), weight, target)
            choices += [(n, residual, chosen, values) for chosen, (values, residual) in zip(some, fits, strict=True)]
    best = min(residual for _, residual, _, _ in choices)
    n_least = min(n for n, residual, _, _ in choices if residual <= AS_GOOD * best)
    _, _, chosen, values = min((c for c in choices if c[0] == n_least), key=lambda c: c[1])
    parts = values[1:] / values[0] if values[0] > 0 else np.zeros(n_least)
    terms = tuple((float(g), tau) for g, tau in zip(parts, chosen, strict=True) if round(g * PART_Q20) > 0)
    if not terms or sum(g for g, _ in terms) >= 1:
        raise InputError(
            "the log shows no relaxation that rubber could have: hold touches for seconds, and check that reference "
            "and frames start at the same instant"
        )
    lost = _lost_of(log, touched, terms)
    after = values[0] * (log.elastic - lost)
    return RelaxationFit(float(values[0]), terms, _rmse(log.elastic, log.reference), _rmse(after, log.reference))


def lost_of(log: RelaxationLog, fit: RelaxationFit) -> Array:
    """What of the elastic wrench has gone in each frame, sum g_k h_k, (t, 6)."""
    touched = np.linalg.norm(log.elastic[:, :3], axis=1) > TOUCHED_N
    return _lost_of(log, touched, fit.terms)


def _rmse(wrench: Array, reference: Array) -> float:
    return float(np.sqrt(np.mean(np.sum((wrench - reference)[:, :3] ** 2, axis=1))))


def _fit(
    log: RelaxationLog, touched: npt.NDArray[np.bool_], times: Array, weight: Array, target: Array
) -> list[tuple[Array, float]]:
    """(a, a g_k) and the residual's L2 norm of each choice of times (choices, k)."""
    parts = np.zeros_like(times)
    for _ in range(ROUNDS):
        lost, fits = _lost(log, touched, times, parts), []
        for i in range(len(times)):
            columns = np.concatenate([log.elastic[..., None], -lost[:, i]], axis=2) * weight[:, None]
            values, residual = nnls(columns.reshape(len(target), -1), target)
            parts[i] = values[1:] / values[0] if values[0] > 0 else parts[i]
            fits.append((values, float(residual)))
    return fits


def _lost_of(log: RelaxationLog, touched: npt.NDArray[np.bool_], terms: Sequence[tuple[float, float]]) -> Array:
    """Sum of g_k h_k of every frame, (t, 6)."""
    parts, times = np.array(terms).T
    return np.asarray(_lost(log, touched, times[None], parts[None])[:, 0] @ parts)


def _lost(log: RelaxationLog, touched: npt.NDArray[np.bool_], times: Array, parts: Array) -> Array:
    """h_k of every frame for each choice of times and parts (choices, k), (t, choices, 6, k).

    Between touches the elastic force is that of the dent that is left.
    """
    state = np.zeros((len(times), 6, times.shape[1]))
    before, dent_of = np.zeros((len(times), 6, 1)), parts[..., None]
    out = np.zeros((len(log.elastic), *state.shape))
    rate = -np.expm1(-np.diff(log.time_s, prepend=log.time_s[0])[:, None, None, None] / times[:, None, :])
    for i, elastic in enumerate(log.elastic[:, :, None]):
        now = elastic if touched[i] else state @ dent_of
        state = state + rate[i] * ((now + before) / 2 - state)
        before = now
        if touched[i]:
            out[i] = state
    return out


def read_relaxation(path: Path, board: Board) -> RelaxationFit:
    """What `reference_log.write_fit` wrote of a fit.

    Raises
    ------
    InputError
        Unreadable, not of this kind, or of another board.
    """
    return read_fit(
        path, board, "cal fit --only relaxation",
        lambda tree: RelaxationFit(
            float(tree["gain"]), tuple((float(t["part"]), float(t["time_s"])) for t in tree["terms"]),
            float(tree["rmse_before_n"]), float(tree["rmse_after_n"]),
        ),
    )  # fmt: skip


def left_after(tensors: Tensors, time_s: float) -> float:
    """Part of the instantaneous force that is left after a while: 1 where nothing relaxes."""
    if "relaxation.part" not in tensors:
        return 1.0
    part, time_ms = (tensors[f"relaxation.{n}"].astype(float) for n in ("part", "time_ms"))
    return float(1 + (part / PART_Q20 * np.expm1(-time_s * 1e3 / time_ms)).sum())
