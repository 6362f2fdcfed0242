"""The board's force of videos beside a load cell, on objects that its fit did not see, and a plain peer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.log.videos import VideoColumns, read_video_log, videos_in
from ruffini.errors import InputError
from ruffini.estimators.softness.model import (
    Share,
    chance_of_wrong,
    dent_of,
    fit_softness,
    gel_pa_of,
    grid_of,
    mean_of,
)
from ruffini.estimators.wrench.fit import fit_wrench_map
from ruffini.estimators.wrench.log import FeatureRun, features_of
from ruffini.estimators.wrench.model import frames_of
from ruffini.evaluate.wrench import on_board
from ruffini.frames import read_frames

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]
Z = 2  # the axis that a load cell reads

# The peer: principal components of the picture made small, less the first frames', and ridge regression.
PEER_SIZE, N_COMPONENTS, N_REFERENCE, PEER_RIDGE = (40, 30), 60, 5, 1.0
LEAST_OBJECTS = 3
LOAD_CELL, PICTURES = "the load cell", "the pictures"  # whose force softness is judged with
UNTOUCHED_S = 1.0  # the gripper closes later
TELLS = 0.05  # chance of being wrong above which two objects cannot be told apart


@dataclass(frozen=True)
class Judged:
    """One closing: truth, statements and their standard deviation (t,), N along z; remarks and the chosen map."""

    run: FeatureRun
    force: Array
    sigma: Array
    flagged: npt.NDArray[np.bool_]
    peer: Array | None
    kernel: str

    @property
    def truth(self) -> Array:
        return self.run.reference[:, Z]


@dataclass(frozen=True)
class Pair:
    """Two objects of one shape, neither in the fit, by their squeezes: which is harder."""

    softer: str
    harder: str
    shares: tuple[list[Share], list[Share]]  # of the softer one's squeezes, and the harder one's

    @property
    def chance(self) -> float:
        """Stated, of being wrong."""
        return chance_of_wrong(*map(mean_of, self.shares)) if all(self.shares) else 0.5

    @property
    def is_told(self) -> bool:
        return self.chance <= TELLS

    @property
    def is_right(self) -> bool:
        return all(self.shares) and mean_of(self.shares[0]).log < mean_of(self.shares[1]).log


@dataclass(frozen=True)
class Found:
    """All closings; sentences on what was left out; pairs by the force that was used: LOAD_CELL or PICTURES."""

    closings: list[Judged]
    remarks: list[str]
    pairs: dict[str, list[Pair]] = field(default_factory=dict)

    def errors(self, said: str = "force") -> dict[str, float]:
        """Mean absolute error by object, of the attribute `force` or `peer` of each closing, N."""
        off = dict[str, list[Array]]()
        for each in self.closings:
            off.setdefault(each.run.recording, []).append(np.abs(getattr(each, said) - each.truth))
        return {name: float(np.concatenate(parts).mean()) for name, parts in off.items()}

    def within(self, n_sigmas: float) -> float:
        """Share of all truths within so many stated standard deviations."""
        return float(np.concatenate([np.abs(c.force - c.truth) <= n_sigmas * c.sigma for c in self.closings]).mean())

    def within_of_touched(self, n_sigmas: float) -> float:
        """Likewise, of the frames on which the board states a force."""
        parts = [(np.abs(c.force - c.truth) <= n_sigmas * c.sigma)[c.force != 0] for c in self.closings]
        return float(np.concatenate(parts).mean())

    def hidden(self) -> list[float]:
        """What the load cell reads on frames on which the board states no force, without a sign, N."""
        return [float(abs(n)) for c in self.closings for n in c.truth[c.force == 0]]

    def at_rest(self) -> float:
        """Mean force of the first second, without a sign, N."""
        return float(np.concatenate([np.abs(c.force[c.run.time_s < UNTOUCHED_S]) for c in self.closings]).mean())

    @property
    def has_peer(self) -> bool:
        return all(each.peer is not None for each in self.closings)


def evaluate(
    folder: Path, board: Board, columns: VideoColumns, *, peers: bool = True, progress: Progress = lambda _: None
) -> Found:
    """Leave each object out wholly, fit to the others, and judge the board's integers on it; softness in floats.

    Raises
    ------
    InputError
        As `read_video_log`, or fewer than three objects.
    """
    log = read_video_log([folder], board, columns, progress=lambda part: progress(0.2 * part))
    names = list(dict.fromkeys(run.recording for run in log.runs))
    if len(names) < LEAST_OBJECTS:
        raise InputError(
            f"{folder}: videos of {len(names)} objects ({', '.join(names)}): {LEAST_OBJECTS} are needed, since each is "
            "judged by a fit to the others, which leaves one more out to choose its terms"
        )
    columns.check_names(names)
    if columns.like and len(names) < LEAST_OBJECTS + 1:
        raise InputError(
            f"{folder}: videos of {len(names)} objects ({', '.join(names)}): {LEAST_OBJECTS + 1} are needed to compare "
            "the objects of like, since both are left out of the fit"
        )
    n_fits = len(names) + sum(len(group) * (len(group) - 1) // 2 for group in columns.like)
    pictures = _small_pictures(folder, board, log.runs) if peers else {}
    closings = list[Judged]()
    for i, name in enumerate(names):
        fitted = [run for run in log.runs if run.recording != name]
        fit = fit_wrench_map(fitted, holdout="recording", nonlinear=True, grid=features_of(board).grid)
        peer = _peer([(pictures[run.name], run.reference[:, Z]) for run in fitted]) if peers else None
        for run in (r for r in log.runs if r.recording == name):
            stated = on_board(fit, frames_of([run], 0.0))
            closings.append(Judged(run, stated.wrench[:, Z], stated.sigma[:, Z], ~stated.is_in_range | ~stated.agrees,
                                   peer(pictures[run.name]) if peer else None, fit.kernel or "K"))  # fmt: skip
        progress(0.2 + 0.8 * (i + 1) / n_fits)
    pairs = dict[str, list[Pair]]()
    for i, (softer, harder) in enumerate(two for group in columns.like for two in combinations(group, 2)):
        for force, pair in _pair(softer, harder, log.runs, board, columns).items():
            pairs.setdefault(force, []).append(pair)
        progress(0.2 + 0.8 * (len(names) + i + 1) / n_fits)
    return Found(closings, log.remarks, pairs)


def _pair(softer: str, harder: str, runs: list[FeatureRun], board: Board, columns: VideoColumns) -> dict[str, Pair]:
    """Two objects by fits of softness and force to all others; by either force."""
    grid, judged, fitted = grid_of(board), (softer, harder), [r for r in runs if r.recording not in (softer, harder)]
    rigid = [name for name in columns.rigid if name not in judged]
    moduli = {name: pa for name, pa in columns.modulus_pa.items() if name not in judged}
    if columns.squeeze_n is None:
        raise InputError("like needs squeeze_n, the two forces between which a squeeze is judged")
    softness = fit_softness(fitted, grid, rigid, columns.squeeze_n, gel_pa_of(board), moduli)
    wrench = fit_wrench_map(fitted, holdout="recording", nonlinear=True, grid=features_of(board).grid)
    shares = {force: {name: list[Share]() for name in judged} for force in (LOAD_CELL, PICTURES)}
    for run in (r for r in runs if r.recording in judged):
        dent, stated = dent_of(run.features, grid), on_board(wrench, frames_of([run], 0.0))
        squeezes = {
            LOAD_CELL: softness.share(dent, -run.reference[:, Z]),
            PICTURES: softness.share(dent, -stated.wrench[:, Z], stated.sigma[:, Z]),
        }
        for force, share in squeezes.items():
            if share is not None:
                shares[force][run.recording].append(share)
    return {force: Pair(softer, harder, (of[softer], of[harder])) for force, of in shares.items()}


def _small_pictures(folder: Path, board: Board, runs: list[FeatureRun]) -> dict[str, Array]:
    """Of each run's frames (t, n), less the mean of the video's first, by the run's name."""
    import cv2

    videos = {video.stem: video for video in videos_in([folder]).read}
    out = dict[str, Array]()
    for run in runs:
        small = [cv2.resize(image, PEER_SIZE, interpolation=cv2.INTER_AREA) for image in read_frames(videos[run.name])]
        rows = np.array(small, np.float64).reshape(len(small), -1)
        used = np.round(run.time_s * board.camera.rate_mhz / 1000).astype(int)
        out[run.name] = (rows - rows[:N_REFERENCE].mean(axis=0))[used]
    return out


def _peer(fitted: list[tuple[Array, Array]]) -> Callable[[Array], Array]:
    from sklearn.decomposition import PCA
    from sklearn.linear_model import Ridge
    from sklearn.pipeline import make_pipeline

    pictures, force = (np.concatenate(parts) for parts in zip(*fitted, strict=True))
    model = make_pipeline(PCA(min(N_COMPONENTS, *pictures.shape), random_state=0), Ridge(PEER_RIDGE))
    model.fit(pictures, force)
    return lambda x: np.asarray(model.predict(x), np.float64)


def picture(found: Found) -> object:
    """Load cell and board over time, a column for each object."""
    from matplotlib.figure import Figure

    errors = found.errors()
    figure = Figure(figsize=(3.2 * len(errors), 6.0), layout="constrained")
    axes = figure.subplots(2, len(errors), sharey=True, squeeze=False)
    for column, (name, error) in enumerate(errors.items()):
        for row, each in enumerate(c for c in found.closings if c.run.recording == name):
            at = axes[row % 2, column]
            time_s = each.run.time_s
            at.fill_between(time_s, -each.force - 2 * each.sigma, -each.force + 2 * each.sigma, color="#bcd4ea", lw=0)
            at.plot(time_s, -each.truth, "k-", lw=1.4, label="load cell")
            at.plot(time_s, -each.force, "-", color="#2f6fab", lw=1.0, label="board, 2 sigma")
            at.plot(time_s[each.flagged], -each.force[each.flagged], ".", color="#c05020", ms=3, label="flagged")
            at.set_title(f"{name}\nMAE {error:.2f} N, {each.kernel}" if row == 0 else each.run.name, fontsize=8)
            at.set_ylim(-5, 30)
    axes[0, 0].legend(fontsize=7)
    for row in axes:
        row[0].set_ylabel("pressing force, N")
    for at in axes[-1]:
        at.set_xlabel("s")
    return figure
