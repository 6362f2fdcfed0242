"""The board's wrench of features on anybody's force log, in its own integers, beside scikit-learn on the same folds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.calibrate import container
from ruffini.calibrate.log.columns import ColumnLogs
from ruffini.core.feature_wrench import Stated, wrench_on_board
from ruffini.estimators.wrench.fit import N_FOLDS, Fit, fit_wrench_map, folds_of
from ruffini.estimators.wrench.log import COLUMNS, FeatureRun, Features
from ruffini.estimators.wrench.model import AXES, Frames, frames_of
from ruffini.estimators.wrench.tables import tables
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Progress = Callable[[float], None]

# Each peer with settings of which the one that errs least on the judged rows counts: the best that it can do.
PEERS: dict[str, list[dict[str, float]]] = {
    "ridge": [{"alpha": a} for a in (1.0, 10.0, 100.0)],
    "kernel ridge": [{"alpha": a, "width": w} for a, w in ((1e-3, 0.1), (1e-2, 1.0), (1e-2, 0.1))],
    "MLP": [{"units": 64}],
}
LIGHT_PART = 0.7  # of the largest force: loads beyond it are left out of one fit, and must be flagged


class Judged(NamedTuple):
    """What the board states of every row that its fit did not see; flagged: out of range or contradicting features."""

    wrench: Array
    sigma: Array
    flagged: Mask
    fits: list[Fit]


@dataclass
class Protocol:
    """One way of leaving rows out: mean absolute errors (6,) by name, and the board's statements."""

    name: str
    truth: Array
    recording: npt.NDArray[np.intp]
    board: Judged
    mae: dict[str, Array] = field(default_factory=dict)

    def within(self, n_sigmas: float) -> float:
        """Share of all truths within so many stated standard deviations."""
        is_measured = self.board.sigma > 0
        off = np.abs(self.board.wrench - self.truth)
        return float((off <= n_sigmas * self.board.sigma)[is_measured].mean())


def evaluate(logs: ColumnLogs, *, peers: bool = True, progress: Progress = lambda _: None) -> list[Protocol]:
    """Every fifth touch left out, five times; with two recordings or more, each fitted alone and judged on the others.

    Raises
    ------
    InputError
        Too few touches, or features that explain nothing.
    """
    frames = frames_of(logs.runs, 0.0)
    ways = [("touches left out", "touch", folds_of(frames, "touch"))]
    recordings = np.unique(frames.recording)
    if len(recordings) > 1:
        alone = [frames.recording != r for r in recordings]
        ways.append(("fitted on one, judged on the others", "block", alone))
    n_jobs, done, out = sum(len(folds) for _, _, folds in ways), 0, list[Protocol]()
    for name, holdout, folds in ways:
        rows, stated, fits = list[npt.NDArray[np.intp]](), list[Stated](), list[Fit]()
        for left in folds:
            fit = fit_wrench_map([part_of(r, k) for r, k in _split(logs.runs, ~left)], holdout=holdout, nonlinear=True)
            stated.append(on_board(fit, frames.take(left)))
            rows.append(np.flatnonzero(left))
            fits.append(fit)
            progress((done := done + 1) / n_jobs)
        order = np.concatenate(rows)
        judged = Judged(np.concatenate([s.wrench for s in stated]), np.concatenate([s.sigma for s in stated]),
                        np.concatenate([~s.is_in_range | ~s.agrees for s in stated]), fits)  # fmt: skip
        protocol = Protocol(name, frames.wrench[order], frames.recording[order], judged)
        protocol.mae["board"] = np.abs(judged.wrench - protocol.truth).mean(axis=0)
        if peers:
            protocol.mae |= {peer: _peer(peer, settings, frames, folds) for peer, settings in PEERS.items()}
        out.append(protocol)
    return out


def beyond(logs: ColumnLogs) -> float:
    """Share of flagged frames among those beyond every fitted load: touches up to `LIGHT_PART` of the largest force."""
    frames = frames_of(logs.runs, 0.0)
    force = np.linalg.norm(frames.wrench[:, :3], axis=1)
    limit = LIGHT_PART * force.max()
    heavy = np.isin(frames.touch, np.unique(frames.touch[force > limit]))
    fit = fit_wrench_map([part_of(r, k) for r, k in _split(logs.runs, ~heavy)], holdout="touch", nonlinear=True)
    said = on_board(fit, frames.take(force > limit))
    return float((~said.is_in_range | ~said.agrees).mean())


def on_board(fit: Fit, frames: Frames) -> Stated:
    """A fit's tables on frames, in the firmware's integers."""
    n = frames.features.shape[1]
    tensors, metadata = tables(fit, Features(COLUMNS, n))
    file = container.pack(tensors, {**container.metadata_without_board(), **metadata})
    return wrench_on_board(file.data, "columns", frames.features, frames.time_s)


def part_of(run: FeatureRun, keep: Mask) -> FeatureRun:
    """Some rows of a run whose reference has a row a frame."""
    when = run.time_s[keep]
    return replace(run, time_s=when, features=run.features[keep], is_good=run.is_good[keep], reference_s=when,
                   reference=run.reference[keep], touch=None if run.touch is None else run.touch[keep])  # fmt: skip


def _split(runs: list[FeatureRun], keep: Mask) -> list[tuple[FeatureRun, Mask]]:
    """The rows of each run, of a mask over all; runs without any are left out."""
    edges = np.cumsum([0, *(len(run.time_s) for run in runs)])
    parts = [(run, keep[a:b]) for run, a, b in zip(runs, edges[:-1], edges[1:], strict=True)]
    return [(run, mask) for run, mask in parts if mask.any()]


def _peer(name: str, settings: list[dict[str, float]], frames: Frames, folds: list[Mask]) -> Array:
    errors = []
    for setting in settings:
        said = np.full_like(frames.wrench, np.nan)
        for left in folds:
            mean, scale = frames.wrench[~left].mean(axis=0), np.maximum(frames.wrench[~left].std(axis=0), 1e-12)
            model = _model(name, setting, frames.features.shape[1])
            model.fit(frames.features[~left], (frames.wrench[~left] - mean) / scale)
            said[left] = model.predict(frames.features[left]) * scale + mean
        errors.append(np.abs(said - frames.wrench).mean(axis=0))
    total = [float((e / np.maximum(frames.wrench.std(axis=0), 1e-12)).sum()) for e in errors]
    return np.asarray(errors[int(np.argmin(total))])


def _model(name: str, setting: dict[str, float], n: int) -> Any:
    from sklearn.kernel_ridge import KernelRidge
    from sklearn.linear_model import Ridge
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    if name == "ridge":
        model: Any = Ridge(setting["alpha"])
    elif name == "kernel ridge":
        model = KernelRidge(alpha=setting["alpha"], kernel="rbf", gamma=setting["width"] / n)
    else:
        model = MLPRegressor(
            hidden_layer_sizes=(int(setting["units"]),), early_stopping=True, max_iter=500, random_state=0
        )
    return make_pipeline(StandardScaler(), model)


def has_peers() -> bool:
    """Whether scikit-learn is installed."""
    from importlib.util import find_spec

    return find_spec("sklearn") is not None


def table(protocols: list[Protocol], flagged: float | None) -> str:
    """As text."""
    lines = [f"mean absolute errors, N and N mm; {N_FOLDS} folds of touches; board: the firmware's integers"]
    for each in protocols:
        lines += ["", each.name]
        lines += aligned(("", *AXES), [(name, *(f"{v:.3f}" for v in mae)) for name, mae in each.mae.items()], "  ")
        lines.append(
            f"  within one stated sigma {100 * each.within(1):.0f} %, two {100 * each.within(2):.0f} %; flagged "
            f"{100 * each.board.flagged.mean():.1f} %; maps: {', '.join(f.kernel or 'K' for f in each.board.fits)}"
        )
    if flagged is not None:
        lines.append(f"\nbeyond every fitted load (touches up to {LIGHT_PART:.0%} of the largest force): "
                     f"{100 * flagged:.0f} % flagged")  # fmt: skip
    return "\n".join(lines)


def as_json(protocols: list[Protocol], flagged: float) -> dict[str, Any]:
    """The same figures."""
    ways = {
        p.name: {
            "mae": {name: mae.tolist() for name, mae in p.mae.items()}, "within_one_sigma": p.within(1),
            "within_two_sigmas": p.within(2), "flagged": float(p.board.flagged.mean()),
            "kernels": [fit.kernel for fit in p.board.fits],
        }
        for p in protocols
    }  # fmt: skip
    return {"unit": "N, N mm", "axes": list(AXES), "left_out": ways, "flagged_beyond": flagged}
