"""Wrench of three targets on a sprung tray: Table III, Fig. 7, 8 and 10 of its paper, by us and by the paper's method.

Both are fitted on the same log of hand loads on the rigid connector (loads.toml, part "fit") and its noisy reference;
both are judged against the twin's truth on other loads, places, indenters and seeds, loading and unloading in equal
parts, where the load is in the paper's ranges. What we say is what the core says of each frame, with the calibration
in force.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.experiments import Experiment, Figure, Options
from papers.ftouch import pictures
from papers.ftouch.method import calibrate, targets, variables
from papers.ftouch.played import RANGES, Played
from papers.recorded import Recorded, each_played
from papers.stated import deviations
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.log.reference import VALID
from ruffini.core import Pipeline
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import pad_view
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.wrench.fit import Fit, fit_wrench_map, linear_map, share_in_disagreement
from ruffini.estimators.wrench.log import FeatureRun, features_of, read_feature_runs
from ruffini.estimators.wrench.model import AXES, TO_NMM, Frames
from ruffini.estimators.wrench.tables import tables
from ruffini.estimators.wrench.target_geometry import second_order_of
from ruffini.estimators.wrench.warmth import Degrees
from ruffini.sim.recording import record_balls
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.make import reproduce as record
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import ReproduceSettings, load_reproduce
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]

BENCH = "loads.toml"
JUDGED = ("paper", "whole", "off_centre")  # its sets of part "judge"
N_BALLS, QUICK_BALLS, BALL_SEED = 40, 15, 11
WRONG_SIGMAS, WRONG_PART = 5.0, 0.05  # an error beyond both without a flag must not be
N_DRAWN = 100_000
RAW = np.array([65536.0, 65536.0, 256.0])  # of a target's features in px and px^2


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Record what is missing, fit, judge, draw."""
    settings = load_reproduce(board, BENCH)
    folder = (options.folder or default_folder(board)) / f"{board.name}-{digest(board, BENCH)[:12]}"
    record(board, folder, bench=BENCH, quick=options.quick, n_workers=options.n_workers,
           progress=lambda p: options.progress(0.6 * p))  # fmt: skip
    runs = _recorded(settings, folder, quick=options.quick)
    fitted = [r for r in runs if r.part == "fit"]
    log = read_feature_runs([r.folder for r in fitted], board)
    fit = fit_wrench_map(log, bend=second_order_of(board))
    data = _calibration(board, fit, folder.with_name(f"{folder.name}-balls"), quick=options.quick)
    k = calibrate(*_papers_log(fitted))
    judged = [r for r in runs if r.part != "fit"]
    played = each_played(
        lambda r: play(board, data, r, k), judged, options.n_workers, lambda p: options.progress(0.8 + 0.2 * p)
    )
    sets = {name: [p for p in played if p.recorded.set_name == name] for name in _names(played)}
    result: dict[str, Any] = {
        "board": board.name, "paper": settings.paper, "simulated": True, "quick": options.quick, "fit": fit.report(),
        "sets": {name: _judge(group) for name, group in sets.items()},
        "routes": _routes(board, log, fit, sets), "drawn_frames": N_DRAWN,
        "false_flags": round(N_DRAWN * share_in_disagreement(fit.map, log, N_DRAWN, np.random.default_rng(3))),
        "published": {p.name: p.value_1e6 * 1e-6 for p in settings.published},
    }  # fmt: skip
    made = pictures.draw(out, sets)
    text = "\n".join([table(result), *(str(path) for path in made)])
    return Experiment(result, text, made, figures(result))


def figures(result: dict[str, Any]) -> dict[str, Figure]:
    """Those of wanted.toml: RMSE by set and axis, the shares within one and two sigmas, wrong forces without a flag."""
    printed: dict[str, float] = result["published"]
    out: dict[str, Figure] = {}
    for name, s in result["sets"].items():
        if name not in JUDGED:
            continue
        for i, axis in enumerate(AXES):
            if s["ours"][i] is not None:
                out[f"{name}, {axis}"] = Figure(s["ours"][i], s["paper"][i], printed.get(axis))
                out |= {f"{name}, {axis} within {k} sigma": Figure(100 * s[f"within_{k}_sigma"][i]) for k in (1, 2)}
        out[f"{name}, wrong without a flag"] = Figure(s["unflagged_wrong"])
    if "false_flags" in result:
        out["false flags in drawn good frames"] = Figure(result["false_flags"])
    return out


def default_folder(board: Board) -> Path:
    """Where recordings are kept between runs."""
    from papers.judged import default_folder as papers_folder

    return papers_folder(board).parent


def _names(played: Sequence[Played]) -> list[str]:
    return list(dict.fromkeys(p.recorded.set_name for p in played))


def _recorded(settings: ReproduceSettings, folder: Path, *, quick: bool) -> list[Recorded]:
    runs = [Recorded(run, folder / run.key) for run in runs_of(settings, quick=quick)]
    return [r for r in runs if (r.folder / "run.json").is_file()]


def _calibration(board: Board, fit: Fit, balls: Path, *, quick: bool) -> bytes:
    """Wrench, and colours to depth from ball presses of the twin: one file, as a unit would have it."""
    wrench, said = tables(fit, features_of(board))
    n = QUICK_BALLS if quick else N_BALLS
    if not (balls / "presses.csv").is_file():
        record_balls(TwinUnit.build(board), n, balls, ball_mm=5.0, seed=BALL_SEED)
    colours = fit_photometric(collect_samples(load_presses(balls), pad_view(board, {}, {})))
    return container.pack({**wrench, **tabulate(colours.model)}, {**container.base_metadata(board), **said}).data


def _papers_log(runs: Sequence[Recorded]) -> tuple[Array, Array]:
    """Nine variables and the reference (N and N m) of the loaded frames of the paper's method."""
    nine, wrench = [], []
    for r in runs:
        unloaded = np.mean([targets(r.picture(i)) for i in range(int(r.touched[0]))], axis=0)
        for frame in r.touched:
            try:
                nine.append(variables(targets(r.picture(int(frame))), unloaded))
            except ValueError:  # not three dark blobs
                continue
            wrench.append(r.rig["force"][frame])
    return np.array(nine), np.array(wrench)


def play(board: Board, data: bytes, r: Recorded, k: Array) -> Played:
    """One run through the core with its calibration, and through the paper's method."""
    first = int(r.touched[0])
    ours, paper, sigma, flags, seen = [], [], [], [], []
    rest: list[Array] = []
    depth, deepest = None, first + int(np.argmin(r.truth["wrench"][first:, 2]))
    with Pipeline(board, data) as core:
        for i in range(len(r.truth["frame"])):
            picture = r.picture(i)
            said = core.process(picture)
            try:
                blobs = targets(picture)
            except ValueError:
                blobs = np.full((3, 3), np.nan)
            if i < first:
                rest.append(blobs)
                continue
            is_said = np.array(said.wrench_validity) == VALID
            ours.append(np.where(is_said, said.wrench * TO_NMM, np.nan))
            paper.append(k @ variables(blobs, np.mean(rest, axis=0)) * TO_NMM)
            sigma.append(deviations(core.covariance()) * TO_NMM)
            flags.append(said.flags)
            seen.append(core.features().reshape(-1, 3) / RAW)
            if i == deepest:
                depth = core.depth_m() * 1e6
        rows = core.targets()
    return Played(
        r, r.truth["wrench"][first:] * TO_NMM, r.rig["force"][first:] * TO_NMM, np.array(ours), np.array(paper),
        np.array(sigma), np.array(flags), np.array(seen),
        np.column_stack([rows[:, :2] / 65536, np.sqrt(rows[:, 2] / 256 / np.pi)]), depth,
    )  # fmt: skip


def _routes(
    board: Board, log: list[FeatureRun], fit: Fit, sets: dict[str, list[Played]]
) -> dict[str, dict[str, list[float]]]:
    """RMSE of three maps of the same features, in float, on every judged set."""
    maps = {"K alone": linear_map(log, fit.lag_s), "quadratic terms by the log": fit_wrench_map(log).map,
            "second order by the geometry": fit.map}  # fmt: skip
    out: dict[str, dict[str, list[float]]] = {name: {} for name in maps}
    for name, group in sets.items():
        judged = np.concatenate([p.judged for p in group])
        truth = np.concatenate([p.truth for p in group])
        period_s = 1000.0 / board.camera.rate_mhz
        frames = Frames(
            np.concatenate([(p.features * RAW).reshape(len(p.features), -1) for p in group]), truth,
            np.concatenate([period_s * np.arange(len(p.truth)) for p in group]),
            run := np.concatenate([np.full(len(p.truth), i) for i, p in enumerate(group)]),
            Degrees.unknown(len(truth)), run, np.full(len(truth), -1),
        )  # fmt: skip
        for route, found in maps.items():
            error = (found.predicted(frames) - truth)[judged]
            out[route][name] = [float(v) for v in np.sqrt((error**2).mean(axis=0))]
    return out


def _judge(group: Sequence[Played]) -> dict[str, Any]:
    """RMSE and R^2 of each axis against the truth, by us and by the paper's method, on the frames that both have.

    None of an axis that no frame says.
    """
    truth, ours, paper, reference, sigma = (
        np.concatenate([getattr(p, name)[p.judged] for p in group])
        for name in ("truth", "ours", "paper", "reference", "sigma")
    )
    flagged = np.concatenate([p.flags != 0 for p in group])
    both = np.isfinite(paper).all(axis=1)
    error = ours - truth
    wrong = (np.abs(error) > WRONG_SIGMAS * sigma) & (np.abs(error) > WRONG_PART * RANGES)
    return {
        "what": group[0].recorded.run.settings.what, "frames": len(truth), "flagged": int(flagged.sum()),
        "paper_lost": int((~both).sum()), "largest": np.abs(truth).max(axis=0).tolist(),
        "ours": _by_axis(_rmse, ours[both], truth[both]), "paper": _by_axis(_rmse, paper, truth),
        "ours_to_reference": _by_axis(_rmse, ours[both], reference[both]),
        "paper_to_reference": _by_axis(_rmse, paper, reference),
        "r2": _by_axis(_explained, ours[both], truth[both]), "paper_r2": _by_axis(_explained, paper, truth),
        "unflagged_wrong": int(wrong.any(axis=1).sum()),
        "within_1_sigma": _by_axis(partial(_covered, 1), error, sigma),
        "within_2_sigma": _by_axis(partial(_covered, 2), error, sigma),
        "within_5_sigma": _by_axis(partial(_covered, 5), error, sigma),
    }  # fmt: skip


def _by_axis(figure: Callable[[Array, Array], float], a: Array, b: Array) -> list[float | None]:
    """`figure` of the rows in which a is finite, axis by axis; None where there are none."""
    kept = np.isfinite(a)
    return [float(figure(a[k, i], b[k, i])) if k.any() else None for i, k in enumerate(kept.T)]


def _rmse(said: Array, truth: Array) -> float:
    return float(np.sqrt(((said - truth) ** 2).mean()))


def _explained(said: Array, truth: Array) -> float:
    """R^2."""
    return float(1 - ((said - truth) ** 2).mean() / max(truth.var(), 1e-12))


def _covered(n_sigmas: float, error: Array, sigma: Array) -> float:
    return float((np.abs(error) < n_sigmas * sigma).mean())


def table(result: dict[str, Any]) -> str:
    """Table III as text, set by set."""
    quick = ", quick: not the figures of the README" if result["quick"] else ""
    printed = result["published"]
    lines = [f"{result['board']}: Table III, SIMULATED{quick}; RMSE in N and N mm (of the range), against the truth"]
    for name, s in result["sets"].items():
        lines += [
            f"{name}: {s['what']}; {s['frames']} frames in the paper's ranges, {s['flagged']} flagged, "
            f"{s['paper_lost']} without three blobs for the paper's method, wrong without a flag: "
            f"{s['unflagged_wrong']}",
            f"  {'':4}{'ours':>16}{'its method':>16}{'ratio':>7}{'R2':>7}{'its R2':>8}{'1, 2, 5 sigma, %':>21}"
            f"{'paper':>16}{'GelSight':>16}",
        ]
        lines += [_row(s, i, printed) for i in range(len(AXES))]
    for route, by_set in result.get("routes", {}).items():
        said = "; ".join(f"{name} " + ", ".join(f"{v:.3g}" for v in e) for name, e in by_set.items())
        lines.append(f"route, {route}: {said}")
    if "false_flags" in result:
        lines.append(f"false flags in {result['drawn_frames']:,} drawn good frames: {result['false_flags']}")
    return "\n".join(lines)


def _row(s: dict[str, Any], i: int, printed: dict[str, float]) -> str:
    """One axis of a set; how often the truth is within the stated sigmas."""
    axis, ours, paper = AXES[i], s["ours"][i], s["paper"][i]
    ratio = "-" if ours is None or paper is None else f"{ours / paper:.2f}"
    covered = "-" if ours is None else ", ".join(f"{100 * s[f'within_{n}_sigma'][i]:.1f}" for n in (1, 2, 5))
    gel = printed.get(f"GelSight, {axis}")
    said = f"{gel:.3g} ({printed[f'GelSight, {axis} of its range']:.1f} %)" if gel else "-"
    return (
        f"  {axis:4}{_of(ours, i):>16}{_of(paper, i):>16}{ratio:>7}{_r2(s['r2'][i]):>7}{_r2(s['paper_r2'][i]):>8}"
        f"{covered:>21}{_of(printed[axis], i):>16}{said:>16}"
    )


def _r2(value: float | None) -> str:
    """Nothing where the axis is hardly loaded."""
    return f"{value:.3f}" if value is not None and value > 0 else "-"


def _of(value: float | None, axis: int) -> str:
    return "not measured" if value is None else f"{value:.3g} ({100 * value / RANGES[axis]:.2f} %)"
