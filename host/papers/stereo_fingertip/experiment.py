"""The stereo fingertip's experiments: Table 5, the full-scale error, Tables A1 to A3, the angle, Table 6, by us.

Ours is fitted on presses.toml (part "fit") and says what the core says of each frame. It is judged on presses.toml
(part "judge": other tools, sizes, places, angles and seeds) and on the tests of the paper's bench (reproduce.toml).
Beside it stands a stand-in for the paper's network (`method`), fitted on the same presses, in its four
input modes. Errors are means of absolute errors over frames, as in the paper, against what the twin truly did.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.experiments import Experiment, Figure, Options
from papers.judged import default_folder
from papers.recorded import Recorded, each_played, shape_of
from papers.stated import coverage, covered
from papers.stereo_fingertip import pictures
from papers.stereo_fingertip import teacher as stereo_teacher
from papers.stereo_fingertip.area import direct
from papers.stereo_fingertip.limits import told_apart
from papers.stereo_fingertip.method import Regression, inputs
from papers.stereo_fingertip.played import AREA, FORCE, ROLL, Played, X, Y, Z
from papers.stereo_fingertip.text import QUANTITIES, SURE_MM, TESTS, text
from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.core import Pipeline
from ruffini.estimators.fingertip.fit import Scale, fit_fingertip
from ruffini.estimators.fingertip.presses import axes, face_area
from ruffini.estimators.fingertip.tables import calibration
from ruffini.sim.indenters.outline import OUTLINES
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.make import reproduce as record
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]

BENCH = "presses.toml"
EYES_MM = 10.0  # apart, section 3.3 of the paper
LEVELS = (0.05, 0.2, 0.4, 0.6, 0.8, 1.05)  # of full scale: the paper's 0.1 to 1 N, and half a step
UNSEEN = ("any", "upright", "centred", "middle", "shapes")  # sets of presses.toml that are judged
PAPER_AREA = {"flat": 0.597, "square": 0.926, "hexagon": 2.857}
BOTH_GREY = 1  # the paper's input mode of both eyes in grey
N_AROUND = 72  # points of a face's outline


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Record what is missing, fit, judge, draw."""

    def within(begin: float, end: float) -> Any:
        return lambda done: options.progress(begin + (end - begin) * done)

    kept = options.folder or default_folder(board).parent
    own, paper = (kept / f"{board.name}-{digest(board, bench)[:12]}" for bench in (BENCH, "reproduce.toml"))
    record(board, own, bench=BENCH, quick=options.quick, n_workers=options.n_workers, progress=within(0.0, 0.3))
    record(board, paper, quick=options.quick, n_workers=options.n_workers, progress=within(0.3, 0.5))
    fit = fit_fingertip(board, own, EYES_MM, within(0.5, 0.8), only="fit*")
    file, full_n = calibration(board, fit), fit.bench.scale.full_n
    ours, tests = _recorded(board, BENCH, own, options.quick), _recorded(board, "reproduce.toml", paper, options.quick)
    judged = [r for r in ours if r.part == "judge"]
    shown, n = [*judged, *(r for r in tests if r.part == "judge")], options.n_workers
    played = each_played(lambda run: play(board, file, run), shown, n)
    one_eyed = {
        eye: each_played(partial(play, board, file, blind=1 - i), judged, n) for i, eye in enumerate(("left", "right"))
    }
    options.progress(0.9)
    result = {
        "simulated": True, "board": board.name, "calibration": fit.report, "quick": options.quick,
        "published": {p.name: p.value_1e6 * 1e-6 for p in load_reproduce(board).published},
        "unseen": {name: figures(_of(played, {name}), full_n) for name in UNSEEN},
        "followed": {name: followed(_of(played, {name}), full_n) for name in UNSEEN},
        "one_eye": {eye: figures(_of(runs, {"any"}), full_n) for eye, runs in one_eyed.items()},
        "paper_tests": _paper_tests(played, full_n), "area": _areas(played),
        "stand_in": {
            str(mode): _stand_in([r for r in ours if r.part == "fit"], judged, mode, full_n) for mode in range(4)
        },
        "direct_area": direct(
            board, fit.bench, [r for r in judged if r.set_name != "shapes"], truth_of, [full_n * p for p in LEVELS]
        ),
        "told_apart": told_apart(board, fit.bench, tests, truth_of), "frame_ms": _times(played),
    }  # fmt: skip
    if options.network is not None:
        runs = [(r, truth_of(r)) for r in [*judged, *(r for r in tests if r.part == "judge")]]
        least_n, most_n = LEVELS[0] * full_n, LEVELS[-1] * full_n
        result["teacher"] = stereo_teacher.judge(board, options.network, runs, least_n, most_n)
    options.progress(1.0)
    return Experiment(result, text(result), pictures.draw(out, played), headline(result))


def headline(result: dict[str, Any]) -> dict[str, Figure]:
    """The figures of wanted.toml: the paper's tests, unseen presses, areas, and how often the area is reported."""
    out: dict[str, Figure] = {}
    for name in TESTS:
        if name in result["paper_tests"]:
            out[f"the paper's test, {name}"] = Figure(result["paper_tests"][name], None, result["published"].get(name))
    stand_in = result["stand_in"][str(BOTH_GREY)]
    for name, row in result["unseen"].items():
        if not row["n_frames"]:
            continue
        for quantity in QUANTITIES[:-1]:
            out[f"{name}, {quantity}"] = Figure(row["mean"][quantity], stand_in[quantity] if name == "any" else None)
        out |= {f"{name}, {what}": Figure(percent) for what, percent in covered(row["stated"], ("force_n",)).items()}
    shapes = result["unseen"]["shapes"]
    if shapes["n_frames"]:
        out["shapes, area error"] = Figure(shapes["mean"]["area_percent"])
    for tool, row in result["area"].items():
        out[f"area error where the whole face bears, {tool}"] = Figure(row["whole"], None, row["paper"])
    frames = [sum(row[part] for row in result["area"].values()) for part in ("n_whole", "of_whole")]
    if frames[1]:
        out["area reported where the whole face bears"] = Figure(100 * frames[0] / frames[1])
    return out


def _recorded(board: Board, bench: str, folder: Path, quick: bool) -> list[Recorded]:
    runs = runs_of(load_reproduce(board, bench), quick=quick)
    return [Recorded(run, folder / run.key) for run in runs if (folder / run.key / "run.json").is_file()]


def truth_of(recorded: Recorded) -> Array:
    """QUANTITIES of each frame of a recording, (t, 7), NaN where nothing touches; area in mm^2."""
    pose, wrench = recorded.truth["pose"], recorded.truth["wrench"]
    out = np.full((len(pose), 7), np.nan)
    area = face_area(shape_of(recorded), float(str(recorded.run.chosen["radius_um"])) * 1e-3)
    for i in np.flatnonzero(np.isfinite(pose[:, 0])):
        x, y, depth, _, roll, pitch = pose[i]
        force = -float(wrench[i, :3] @ axes(roll, pitch)[:, 2])
        out[i] = [force, depth * 1e3, x * 1e3, y * 1e3, np.rad2deg(roll), np.rad2deg(pitch), area]
    return out


def is_whole(tool: str, radius_mm: float, truth: Array, dome_mm: float) -> bool:
    """Whether all of a flat face's outline is below the undeformed dome; truth (7,) of one frame."""
    if tool not in OUTLINES:
        return False
    angle = np.linspace(0, 2 * np.pi, N_AROUND, endpoint=False)
    way = np.linspace(0, 2.2, 2001)
    inside = OUTLINES[tool](way[None] * np.cos(angle)[:, None], way[None] * np.sin(angle)[:, None]) <= 0
    edge = radius_mm * (way[None] * inside).max(axis=1)
    at = truth[[X, Y]] + edge[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    nearest = np.linalg.norm(np.linspace(0, 1, 101)[:, None, None] * (at - truth[[X, Y]]) + truth[[X, Y]], axis=2).min()
    first = np.sqrt(dome_mm**2 - nearest**2)  # height of the face when it touches
    height = np.sqrt(np.maximum(dome_mm**2 - (at**2).sum(axis=1), 0))
    return bool((height > first - truth[Z]).all())


def _in_range(truth: Array, full_n: float) -> npt.NDArray[np.bool_]:
    return np.asarray((truth[:, FORCE] >= LEVELS[0] * full_n) & (truth[:, FORCE] <= LEVELS[-1] * full_n))


def play(board: Board, file: CalibrationFile, recorded: Recorded, blind: int | None = None) -> Played:
    """What the core says of a recording; with `blind`, while that eye sees nothing."""
    truth, tool = truth_of(recorded), shape_of(recorded)
    radius_mm = float(str(recorded.run.chosen["radius_um"])) * 1e-3
    dome_mm = load_twin(board).shape.radius_um * 1e-3
    rows, sigma, known, at, spent = [], [], [], [], []
    is_judged = _in_range(truth, Scale.of(board).full_n)
    with Pipeline(board, file.data) as core:
        for i in range(len(truth)):
            picture = recorded.picture(i)
            if blind is not None and i >= board.pipeline.n_rest_frames:
                half = picture.shape[1] // 2
                picture[:, blind * half : (blind + 1) * half] = 0
            start = time.thread_time()  # others play beside it
            frame = core.process(picture)
            if not is_judged[i]:
                continue
            spent.append(1e3 * (time.thread_time() - start))
            tip = core.tip()
            at.append(i)
            known.append(bool(tip.is_touched) and frame.force_z_validity == 1)
            number = np.array(tip[3:17], dtype=float)
            number *= [1e-6, 1e-3, 1e-3, 1e-3, *2 * [np.rad2deg(1e-6)], 1e-6] * 2
            rows.append(number[:7])
            sigma.append(number[7:])
    whole = [is_whole(tool, radius_mm, truth[i], dome_mm) for i in at]
    shape = (-1, 7)
    return Played(
        recorded.set_name, tool, truth[at], np.array(rows).reshape(shape), np.array(sigma).reshape(shape),
        np.array(known, dtype=bool), np.array(whole, dtype=bool), np.array(spent),
    )  # fmt: skip


def _of(played: Iterable[Played], names: set[str]) -> list[Played]:
    return [p for p in played if p.name in names and len(p.truth)]


def _rows(played: list[Played], name: str) -> Array:
    return np.concatenate([getattr(p, name) for p in played]) if played else np.zeros((0, 7))


def figures(played: list[Played], full_n: float = 1.0) -> dict[str, Any]:
    """Mean absolute errors over all frames, by force level, and where ours calls the place known."""
    if not played:
        return {"n_frames": 0}
    off, truth, sigma = np.abs(_rows(played, "off")), _rows(played, "truth"), _rows(played, "sigma")
    known = np.concatenate([p.is_known for p in played])
    mean = dict(zip(QUANTITIES, _means(off[known]), strict=True))
    levels = {}
    for low, high in pairwise(LEVELS):
        some = known & (truth[:, FORCE] >= low * full_n) & (truth[:, FORCE] < high * full_n)
        if some.any():
            name = f"{low * full_n:g}-{high * full_n:g}"
            levels[name] = dict(zip(QUANTITIES, _means(off[some]), strict=True))
    sure = known & (sigma[:, X] <= SURE_MM)
    places = {"x_mm": _mean(off[sure, X]), "y_mm": _mean(off[sure, Y])}
    unit = np.where(np.arange(7) == AREA, truth[known, AREA, None] / 100, 1.0)
    is_told = np.isfinite(off[known])  # not of a ball's face, nor where the area is not told
    stated = {q: coverage((off[known] * unit)[:, i], sigma[known, i]) for i, q in enumerate(QUANTITIES)}
    return {
        "area_told_percent": 100 * float(is_told[:, AREA].mean()),
        "n_runs": len(played), "n_frames": len(off), "told_percent": 100 * float(known.mean()), "mean": mean,
        "by_force": levels,
        "stated": stated,
        "sure_of_place": {"percent": 100 * float(sure.mean()), **places},
    }  # fmt: skip


def followed(played: list[Played], full_n: float = 1.0) -> dict[str, Any]:
    """Errors of X and Y of a tool that is followed while it presses: the mean of what was said of it so far, each by
    its precision. A tool that comes down straight keeps its X and Y.
    """
    runs = []
    for p in played:
        weight = np.where(p.is_known[:, None], 1 / np.maximum(p.sigma[:, [X, Y]], 1e-6) ** 2, 1e-9)
        ours = p.ours.copy()
        ours[:, [X, Y]] = (weight * ours[:, [X, Y]]).cumsum(axis=0) / weight.cumsum(axis=0)
        runs.append(replace(p, ours=ours))
    said = figures(runs, full_n)
    by = said.get("by_force", {})
    return {
        axis: {"mean": said["mean"][axis], **{level: row[axis] for level, row in by.items()}} if runs else {}
        for axis in ("x_mm", "y_mm")
    }


def _mean(values: Array) -> float:
    """Of those that are told."""
    told = values[np.isfinite(values)]
    return float(told.mean()) if len(told) else float("nan")


def _means(rows: Array) -> list[float]:
    return [_mean(column) for column in rows.T]


def _paper_tests(played: list[Played], full_n: float = 1.0) -> dict[str, Any]:
    """The paper's own tests: Table 5, full-scale error, Tables A1 to A3, Figs. 18 and 19; by names of [[published]]."""
    force, along_x, along_y, turned = (_of(played, {f"test_{name}"}) for name in ("force", "x", "y", "angle"))
    if not force:
        return {}
    full = [100 * np.abs(p.off[:, FORCE]).max() / p.truth[:, FORCE].max() for p in force]
    return {
        "force": _mean(np.abs(_rows(force, "off")[:, FORCE])),
        "force_of_each_test": [_mean(np.abs(p.off[:, FORCE])) for p in force],
        "full-scale error": float(np.mean(full)), "full_scale_of_each_test": [float(f) for f in full],
        "X": _mean(np.abs(_rows(along_x, "off")[:, X])), "Y": _mean(np.abs(_rows(along_y, "off")[:, Y])),
        "Z": _mean(np.abs(_rows(force, "off")[:, Z])), "angle of 45": _mean(np.abs(_rows(turned, "off")[:, ROLL])),
        "X_by_force": figures(along_x, full_n).get("by_force", {}),
        "Y_by_force": figures(along_y, full_n).get("by_force", {}),
        "Z_by_force": figures(force, full_n).get("by_force", {}),
        "angle_by_force": figures(turned, full_n).get("by_force", {}),
        "table_a1": [_table(p, FORCE) for p in force],
        "table_a2": [_table(p, X) for p in along_x], "table_a3": [_table(p, Y) for p in along_y],
    }  # fmt: skip


def _table(p: Played, quantity: int) -> dict[str, Any]:
    """One test frame by frame, as Tables A1 to A3 have it."""
    return {
        "true": float(p.truth[-1, quantity]), "force_n": p.truth[:, FORCE].tolist(),
        "estimated": p.ours[:, quantity].tolist(), "error": np.abs(p.off[:, quantity]).tolist(),
    }  # fmt: skip


def _areas(played: list[Played]) -> dict[str, Any]:
    """Table 6: error of the area, percent, by tool; whole contacts and partial ones."""
    out: dict[str, Any] = {}
    judged = _of(played, {"any", "upright", "centred", "middle"})
    for tool, paper in PAPER_AREA.items():
        own = [p for p in judged if p.tool == tool]
        if not own:
            continue
        off, whole = np.abs(_rows(own, "off")[:, AREA]), np.concatenate([p.is_whole for p in own])
        told = np.isfinite(off)
        out[tool] = {
            "whole": _mean(off[whole]), "n_whole": int((whole & told).sum()), "of_whole": int(whole.sum()),
            "partial": _mean(off[~whole]), "n_partial": int((~whole & told).sum()), "of_partial": int((~whole).sum()),
            "paper": paper,
        }  # fmt: skip
    return out


def _samples(runs: list[Recorded], mode: int, full_n: float) -> tuple[Array, Array]:
    rows, labels = [], []
    for recorded in runs:
        truth = truth_of(recorded)
        for i in np.flatnonzero(_in_range(truth, full_n)):
            rows.append(inputs(recorded.picture(int(i)), mode))
            labels.append(truth[i, :6])
    return np.array(rows), np.array(labels)


def _stand_in(fit: list[Recorded], judged: list[Recorded], mode: int, full_n: float) -> dict[str, float]:
    """Errors of the stand-in network, fitted on our presses in one of the paper's input modes, on the set `any`."""
    some = [r for r in judged if r.set_name == "any"]
    model = Regression.fit(*_samples(fit, mode, full_n))
    rows, labels = _samples(some, mode, full_n)
    return {q: float(e) for q, e in zip(QUANTITIES, np.abs(model(rows) - labels).mean(axis=0), strict=False)}


def _times(played: list[Played]) -> dict[str, float]:
    spent = np.concatenate([p.frame_ms for p in played])
    return {"median": float(np.median(spent)), "p99": float(np.percentile(spent, 99)), "most": float(spent.max())}
