"""The electroluminescent skin's experiments: Fig. 9 to 12, Tables I and II of its paper, by us and by its own method.

Ours is fitted on presses.toml (part "fit") and says what the core says of each frame, with the calibration in force.
The paper's method is fitted as the paper does, on the ten points that it is judged on. Both are judged on the paper's
bench (reproduce.toml) and on presses.toml (part "judge"): other places, tips, depths, speeds and seeds, loading and
unloading alike.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from papers.eltac import pictures
from papers.eltac.bench import AVERAGES, EDGE_POINTS, LARGEST_N, TARGETS_N, TUBE_MM, _calibrated
from papers.eltac.method import SIGMA_PX, Camera, Cylinder, brightest, force_curve
from papers.eltac.played import Played
from papers.experiments import Experiment, Figure, Options
from papers.judged import default_folder
from papers.recorded import Recorded, each_played
from papers.stated import Coverage, coverage, covered
from papers.stated import lines as stated_lines
from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile
from ruffini.core import Pipeline
from ruffini.estimators.skin.fit import fit_skin, taxel_file
from ruffini.sim.optics.known_points import known_points
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.make import reproduce as record
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce

Array = npt.NDArray[np.float64]

BENCH = "presses.toml"
WRONG_SIGMAS, WRONG_PART = 5.0, 0.05  # an error beyond both without a flag must not be
FULL_SCALE_N = LARGEST_N
LEVELS_N = np.arange(2.0, LARGEST_N, 0.5)  # where loading and unloading are compared
FELT_N = 0.8  # a touch must be told above this load
PANEL_MM = 42.9  # middle of the panels, which tools touch in the twin
RESOLVED_MM = 5.0  # a finger counts as found within this of its place: a third of the smallest distance
PAPER_PLACE_MM = {"1": 6.22, "2": 6.47, "3": 6.37, "4": 6.90, "5": 7.19}
PAPER_FORCE = {10: (10.6, 8.2), 5: (10.2, 7.7), 3: (9.3, 7.6), 1: (11.7, 7.8)}  # Table I: mean, standard deviation
PAPER_LOSS = {0.1: 28.27, 0.5: 25.68, 1.0: 23.27, 2.0: 21.62, 4.0: 23.84}  # Table II


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Record what is missing, fit, judge, draw."""

    def within(begin: float, end: float) -> Any:
        return lambda done: options.progress(begin + (end - begin) * done)

    own = (options.folder or default_folder(board).parent) / f"{board.name}-{digest(board, BENCH)[:12]}"
    paper = (options.folder or default_folder(board).parent) / f"{board.name}-{digest(board)[:12]}"
    quick, n = options.quick, options.n_workers
    record(board, own, bench=BENCH, quick=quick, n_workers=n, progress=within(0.0, 0.3))
    record(board, paper, quick=quick, n_workers=n, progress=within(0.3, 0.6))
    fit = fit_skin(board, known_points(board), own, within(0.6, 0.7), only="fit_*")
    file = taxel_file(board, fit)
    runs = [*_recorded(board, BENCH, own, options.quick), *_recorded(board, "reproduce.toml", paper, options.quick)]
    judged = [r for r in runs if r.part == "judge" or r.set_name == "curve"]
    played = each_played(lambda run: play(board, file, run), judged, n, within(0.7, 1.0))
    result, text = judge(board, played, fit.report, quick=quick)
    return Experiment(result, text, pictures.draw(out, played, result), figures(result))


def figures(result: dict[str, Any]) -> dict[str, Figure]:
    """Those of wanted.toml: places in mm, forces and hysteresis in %, two fingers in % of the frames."""
    out: dict[str, Figure] = {}
    for name, row in result["places"].items():
        what = name if name.startswith("other") else f"indenter {name}"
        out[f"position, {what}"] = Figure(row["ours"], row.get("method"), row.get("paper"))
    for name, row in result["forces"].items():
        if "ours" in row and name.startswith("points"):
            out[f"force, {name}"] = Figure(row["ours"], row["method"], row.get("paper"))
    for name, row in result["both_ways"].items():
        out |= {f"force at every level, {name}, {way}": Figure(row[way]) for way in ("down", "up") if way in row}
    for speed, row in result["loops"].items():
        out[f"hysteresis left at {speed} mm/s"] = Figure(row["split_ours"], row["split_quadratic"], row["paper"])
    if "ours" in result["trials"]:
        out["spread of five trials"] = Figure(result["trials"]["ours"], result["trials"]["brightness"])
    out |= {f"two fingers at {how}": Figure(100 * part) for how, part in result["two_fingers"].items()}
    out["wrong without a flag"] = Figure(result["unflagged"]["wrong"])
    out |= {name: Figure(percent) for name, percent in covered(result["stated"], ("force", "place")).items()}
    return out


def _recorded(board: Board, bench: str, folder: Path, quick: bool) -> list[Recorded]:
    runs = runs_of(load_reproduce(board, bench), quick=quick)
    return [Recorded(run, folder / run.key) for run in runs if (folder / run.key / "run.json").is_file()]


def play(board: Board, file: CalibrationFile, recorded: Recorded) -> Played:
    """What the core says of a recording, and the paper's brightness of it."""
    truth, first = recorded.truth, int(recorded.touched[0])
    angle = float(truth["pose"][first, 0]) * 1e3 / TUBE_MM
    inwards = -np.array([np.cos(angle), np.sin(angle), 0.0])
    ours, sigma, flags, touches, place_sigma, level, peak = [], [], [], [], [], [], []
    rest = recorded.rest()[..., :2].sum(axis=-1)
    with Pipeline(board, file.data) as core:
        for i in range(len(truth["pose"])):
            picture = recorded.picture(i)
            frame = core.process(picture, float(truth["time_s"][i]))
            if i not in recorded.touched:
                continue
            rows = core.touches()
            ours.append(1e-6 * sum(t.press_un for t in rows))
            sigma.append(1e-6 * float(np.sqrt(sum(t.press_sigma_un**2 for t in rows))))
            flags.append(frame.flags)
            touches.append(np.array([(t.x_um, t.y_um) for t in rows]).reshape(-1, 2) * 1e-3)
            place_sigma.append(np.array([t.place_sigma_um for t in rows]) * 1e-3)
            change = cv2.GaussianBlur(picture[..., :2].sum(axis=-1, dtype=np.float64) - rest, (0, 0), SIGMA_PX)
            u, v, brightness = brightest(np.asarray(change))
            level.append(brightness)
            peak.append((u, v))
    at = recorded.touched
    return Played(
        recorded, truth["wrench"][at, :3] @ inwards, recorded.rig["force"][at, :3] @ inwards, np.array(ours),
        np.array(sigma), np.array(flags), touches, place_sigma, np.array(level), np.array(peak),
    )  # fmt: skip


def on_tube(place_mm: Array) -> Array:
    """Points (..., 3) of the paper's tube."""
    angle = place_mm[..., 0] / TUBE_MM
    return np.stack([TUBE_MM * np.cos(angle), TUBE_MM * np.sin(angle), place_mm[..., 1]], axis=-1)


def away(found: Array, place: Array) -> float:
    """Distance (mm) of the nearest of places (k, 2) from one."""
    return float(np.linalg.norm(on_tube(found) - on_tube(place), axis=1).min()) if len(found) else np.nan


def judge(
    board: Board, played: list[Played], calibration: dict[str, Any], *, quick: bool = False
) -> tuple[dict[str, Any], str]:
    """Every table, and the text of it."""
    camera, cylinder = _calibrated(board)
    pairs = np.concatenate([np.column_stack([p.level, p.cell]) for p in played if p.name == "curve"])
    pairs = pairs[pairs[:, 1] <= LARGEST_N]
    curve = force_curve(pairs[:, 0], pairs[:, 1])
    result: dict[str, Any] = {
        "simulated": True, "board": board.name, "quick": quick, "calibration": calibration, "curve": curve.tolist(),
        "places": _places(played, camera, cylinder), "forces": _forces(played, curve),
        "both_ways": _both_ways(played), "loops": _loops(played, curve), "trials": _trials(played),
        "two_fingers": _two_fingers(played), "unflagged": _unflagged(played), "stated": _stated(played),
    }  # fmt: skip
    return result, _text(result)


def _places(played: list[Played], camera: Camera, cylinder: Cylinder) -> dict[str, dict[str, float]]:
    """Fig. 9 by indenter, mm: ours against the truth and against what a person noted, the paper's method, the paper."""
    rows: dict[str, dict[str, float]] = {}
    for number, paper in PAPER_PLACE_MM.items():
        runs = [p for p in played if p.name == f"locate_{number}"]
        noted = [p.recorded.rig["place_m"] * 1e3 for p in runs]
        method = [cylinder.place(*camera.polar(*p.peak_px[-1])) for p in runs]
        rows[number] = {
            "n": len(runs),
            "ours": float(np.nanmean([away(p.touches[-1], p.place) for p in runs])),
            "ours_noted": float(np.nanmean([away(p.touches[-1], at) for p, at in zip(runs, noted, strict=True)])),
            "method_noted": float(np.mean(np.linalg.norm(np.array(method) - on_tube(np.array(noted)), axis=1))),
            "method": float(np.mean([np.linalg.norm(m - on_tube(p.place)) for m, p in zip(method, runs, strict=True)])),
            "paper": paper,
        }  # fmt: skip
    others = [
        away(found, p.place)
        for p in played
        if p.name.startswith("judge_place")
        for found, load in zip(p.touches, p.load, strict=True)
        if load > FELT_N
    ]
    rows["other places"] = {"n": len(others), "ours": float(np.nanmean(others)) if others else np.nan}
    return rows


def _point(played: Played) -> int:
    return int(played.recorded.run.key[-4:])


def _forces(played: list[Played], curve: Array) -> dict[str, dict[str, float]]:
    """Table I: error (%) of the mean over the last frames before 3, 5 and 9 N, and its standard deviation."""
    rows: dict[str, dict[str, float]] = {}
    for where in ("points 3 to 9", "edge points"):
        runs = [p for p in played if p.name == "force" and (_point(p) in EDGE_POINTS) == (where == "edge points")]
        for n, name in AVERAGES.items():
            for who in ("ours", "method"):
                said = [p.ours if who == "ours" else quadratic(curve, p) for p in runs]
                errors = [e for p, estimate in zip(runs, said, strict=True) for e in _at_targets(p, estimate, n)]
                row = rows.setdefault(f"{where}, {name}", {})
                row[who] = float(np.mean(errors)) if errors else np.nan
                row[f"{who}_sd"] = float(np.std(errors, ddof=1)) if len(errors) > 1 else np.nan
                if where != "edge points":
                    row["paper"], row["paper_sd"] = PAPER_FORCE[n]
    return rows


def _at_targets(p: Played, estimate: Array, n: int) -> list[float]:
    out = []
    for target in TARGETS_N:
        reached = np.flatnonzero(p.cell >= target)
        if reached.size:
            rows = slice(max(0, int(reached[0]) - n + 1), int(reached[0]) + 1)
            cell = float(p.cell[rows].mean())
            out.append(100 * abs(float(estimate[rows].mean()) - cell) / cell)
    return out


def _both_ways(played: list[Played]) -> dict[str, dict[str, float]]:
    """Error (%) at levels of the true force, down and up alike."""
    rows: dict[str, dict[str, float]] = {}
    for where in ("points 3 to 9", "edge points"):
        runs = [p for p in played if p.name == "judge_force" and (_point(p) in EDGE_POINTS) == (where == "edge points")]
        each = {way: [_relative(p, p.ours, way) for p in runs] for way in ("down", "up")}
        rows[where] = {way: 100 * float(np.nanmean(np.abs(np.array(e)))) for way, e in each.items() if e}
        rows[where]["mean"] = float(np.mean(list(rows[where].values()))) if rows[where] else np.nan
    return rows


def _relative(p: Played, estimate: Array, way: str) -> Array:
    """(estimate - load) / load where the load passes each of LEVELS_N, NaN where it does not."""
    at = p.is_down if way == "down" else ~p.is_down
    order = np.argsort(p.load[at])
    load, said = p.load[at][order], estimate[at][order]
    inside = (load[0] <= LEVELS_N) & (load[-1] >= LEVELS_N)
    return np.asarray(np.where(inside, np.interp(LEVELS_N, load, said) / LEVELS_N - 1, np.nan))


def _loops(played: list[Played], curve: Array) -> dict[str, dict[str, float]]:
    """Table II by speed: loss (%) of the bench and as we tell it; how far up is from down, ours and the quadratic."""
    rows = {}
    for p in (p for p in played if p.name == "loops"):
        speed = float(str(p.recorded.run.chosen["speed_um_s"])) * 1e-3
        split = {
            who: 100 * float(np.nanmean(np.abs(_relative(p, e, "up") - _relative(p, e, "down"))))
            for who, e in (("ours", p.ours), ("quadratic", quadratic(curve, p)))
        }
        rows[f"{speed:g}"] = {
            "bench": _loss(p.cell, p.way), "ours": _loss(p.ours, p.way), "paper": PAPER_LOSS[speed],
            "split_ours": split["ours"], "split_quadratic": split["quadratic"],
        }  # fmt: skip
    return rows


def quadratic(curve: Array, p: Played) -> Array:
    """The paper's force of every frame, (t,) N."""
    return np.asarray(np.polyval(curve, p.level), dtype=np.float64)


def _loss(force: Array, way: Array) -> float:
    turn = int(np.argmax(way)) + 1
    put_in = float(np.trapezoid(np.append(0, force[:turn]), np.append(0, way[:turn])))
    return 100 * (1 + float(np.trapezoid(force[turn - 1 :], way[turn - 1 :])) / put_in)


def _trials(played: list[Played]) -> dict[str, float]:
    """Fig. 12: spread (%) of five trials at 5 N, of brightness and of our force."""
    runs = [p for p in played if p.name == "repeat"]
    if len(runs) < 2:
        return {}
    at = {
        "brightness": [float(np.interp(5.0, np.maximum.accumulate(p.cell), p.level)) for p in runs],
        "ours": [float(np.interp(5.0, np.maximum.accumulate(p.cell), p.ours)) for p in runs],
    }
    return {name: 100 * float(np.std(v, ddof=1) / np.mean(v)) for name, v in at.items()}


def _two_fingers(played: list[Played]) -> dict[str, float]:
    """Part of the frames above 2 N with both fingers told within RESOLVED_MM, of each distance and direction."""
    told: dict[str, list[bool]] = {}
    for p in sorted(played, key=lambda p: p.name):
        second = getattr(p.recorded.run.settings, "second", None)
        if not p.name.startswith("judge_two") or second is None:
            continue
        how = f"{second.distance_um / 1e3:g} mm, {p.name.split('_')[2]}"
        told.setdefault(how, []).extend(
            max(away(found, place) for place in fingers(p, way)) < RESOLVED_MM and len(found) == 2
            for found, load, way in zip(p.touches, p.load, p.way, strict=True)
            if load > 2.0
        )
    return {how: float(np.mean(frames)) for how, frames in told.items() if frames}


def fingers(p: Played, way_m: float) -> list[Array]:
    """Where two balls on one holder touch the tube, on its chart: on the way from its axis to each ball's middle."""
    second = getattr(p.recorded.run.settings, "second", None)
    assert second is not None
    turn, half = second.turn_mrad * 1e-3, second.distance_um * 5e-4
    aside, along = half * np.cos(turn), half * np.sin(turn)
    first_touch = np.sqrt((PANEL_MM + second.radius_um * 1e-3) ** 2 - aside**2)
    step = np.array([TUBE_MM * np.arctan2(aside, first_touch - way_m * 1e3), along])
    return [p.place - step, p.place + step]


def _unflagged(played: list[Played]) -> dict[str, int]:
    """Frames of single touches to full scale; flagged; none or more than one told; told, but beyond 5 sigma and 5 %."""
    frames = flagged = missed = split = wrong = 0
    for p in played:
        if p.recorded.part != "judge" or p.name.startswith("judge_two"):
            continue
        used = (p.load > FELT_N) & (p.load < FULL_SCALE_N)
        off = np.abs(p.ours - p.load)
        frames += int(used.sum())
        flagged += int((used & (p.flags != 0)).sum())
        told = np.array([len(found) > 0 for found in p.touches])
        missed += int((used & (p.flags == 0) & ~told).sum())
        split += int((used & np.array([len(found) > 1 for found in p.touches])).sum())
        bad = used & (p.flags == 0) & told & (off > WRONG_SIGMAS * p.sigma) & (off > WRONG_PART * FULL_SCALE_N)
        wrong += int(bad.sum())
    return {"frames": frames, "flagged": flagged, "missed": missed, "split": split, "wrong": wrong}


def _stated(played: list[Played]) -> dict[str, Coverage]:
    """Of single touches above FELT_N to full scale, unflagged: force in N; place in mm, along both directions."""
    off, sigma, away_mm, place_sigma = [], [], [], []
    for p in played:
        if p.recorded.part != "judge" or p.name.startswith("judge_two"):
            continue
        for i in np.flatnonzero((p.load > FELT_N) & (p.load < FULL_SCALE_N) & (p.flags == 0)):
            if len(p.touches[i]) == 1:
                off.append(p.ours[i] - p.load[i])
                sigma.append(p.sigma[i])
                away_mm.append(p.touches[i][0] - p.place)
                place_sigma.append(2 * [p.place_sigma[i][0]])
    return {
        "force": coverage(np.array(off), np.array(sigma)),
        "place": coverage(np.array(away_mm).reshape(-1, 2), np.array(place_sigma).reshape(-1, 2)),
    }


def _lines(title: str, names: Iterable[str], rows: dict[str, dict[str, float]]) -> list[str]:
    names = list(names)
    lines = [title, "  " + " " * 28 + "".join(f"{n:>16}" for n in names)]
    for name, row in rows.items():
        lines.append(f"  {name:28}" + "".join(f"{row[n]:16.3g}" if n in row else f"{'':16}" for n in names))
    return lines


def _text(r: dict[str, Any]) -> str:
    forces = ("ours", "ours_sd", "method", "method_sd", "paper", "paper_sd")
    return "\n".join([
        f"{r['board']}: SIMULATED{', QUICK: fewer runs, not the figures of the README' if r['quick'] else ''}",
        *_lines("Fig. 9, place, mm", ("n", "ours", "ours_noted", "method", "method_noted", "paper"), r["places"]),
        *_lines("Table I, force at 3, 5 and 9 N, %", forces, r["forces"]),
        *_lines("Force at every level, down and up, %", ("down", "up", "mean"), r["both_ways"]),
        *_lines("Table II by mm/s, %", ("bench", "ours", "paper", "split_ours", "split_quadratic"), r["loops"]),
        "Fig. 12, spread of five trials at 5 N, %: "
        + (", ".join(f"{k} {v:.2g}" for k, v in r["trials"].items()) or "not played"),
        "Two fingers told: " + ", ".join(f"{k} {100 * v:.0f} %" for k, v in r["two_fingers"].items()),
        *stated_lines("Stated uncertainty of single touches, N and mm", r["stated"]),
        "Frames {frames}, flagged {flagged}, no touch told {missed}, told as more than one {split}, "
        "told and wrong without a flag {wrong}".format(
            **r["unflagged"]
        ),
    ])  # fmt: skip
