"""`cal fit --only skin`: a glowing skin's kind `skin` of proto/CALIBRATION.md, from known points and presses.

Taxels have all that `response` and `places` fit to presses.
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate.container import CalibrationFile, Tensors, base_metadata, pack
from ruffini.calibrate.report.fewer_presses import Figures, Numbers, accuracy_of_presses
from ruffini.errors import InputError
from ruffini.estimators.skin.gain import COLUMNS
from ruffini.estimators.skin.openings import Openings, TubeView, find_openings, fit_view, lattice_mm
from ruffini.estimators.skin.pairs import most_excess
from ruffini.estimators.skin.places import PlaceFit, errors, fit_places
from ruffini.estimators.skin.presses import (
    Press,
    n_untouched,
    press_folders,
    read_presses,
    reference_of,
    skin_of,
    weighted,
)
from ruffini.estimators.skin.reach import APART_LEAST, APART_MARGIN, REACH_STEP_MM, fit_reach, unexplained
from ruffini.estimators.skin.response import (
    FLOOR,
    TIMES_S,
    ForceFit,
    Layout,
    fit_force,
    gain_kinds,
    layout_of,
    rims,
    sinks,
)
from ruffini.estimators.skin.spread import HARD_N, LIGHT_N, Errors, Spread, spread_by_kind
from ruffini.files import readable
from ruffini.frames import Frames

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

RATIO_STEP, RATIO_SIZE = 64, 577  # of firmware/stages/skin/taxel_tables.h
STRAY_LIMIT_Q6 = (
    32  # light from outside: half a level of the weighted sum, ten times a patch's noise and JPEG's ringing
)
N_FOLDS = 10  # with fewer, whole corners of the skin are left out at once, and err more than they do in use
CELLS = 3
N_KINDS = 2 * COLUMNS  # of taxels, as gain_kinds numbers them
SIGMA_KEYS = ("skin.sigma_un", "skin.sigma_q12", "skin.place_sigma_um", "skin.faint_place_sigma_um")


@dataclass(frozen=True)
class SkinFit:
    """What was fitted, and what it says of itself."""

    view: TubeView
    openings: Openings
    layout: Layout
    force: ForceFit
    places: PlaceFit
    reach: Array
    apart: float
    pair: float
    spread: list[Spread]  # of each kind of taxel
    report: dict[str, Any]
    light_q2: npt.NDArray[np.int32]


def read_points(path: Path) -> Array:
    """Known points (n, 3): image x, y (px), height along the tube (mm), of a CSV with columns x_px, y_px, z_mm.

    Raises
    ------
    InputError
        It cannot be read or has other columns.
    """
    try:
        with readable(path).open(newline="", encoding="utf-8-sig") as file:
            rows = [[float(row[c]) for c in ("x_px", "y_px", "z_mm")] for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is no list of points with columns x_px, y_px, z_mm ({error})") from error
    return np.array(rows).reshape(-1, 3)


def untouched(board: Board, folder: Path) -> Array:
    """Mean of a press's untouched frames, (h, w, 3) grey levels."""
    _, force, _ = reference_of(folder, board)
    n_rest = n_untouched(folder, board, force)
    return np.asarray(np.mean(list(Frames(folder))[:n_rest], axis=0, dtype=np.float64))


def fit_skin(
    board: Board, points: Array, presses: Path, progress: Progress = lambda _: None, *, only: str = "*"
) -> SkinFit:
    """Fit everything to known points and a folder of presses; `only` : pattern of the folders in it that count.

    Raises
    ------
    InputError
        No glowing skin, points or presses that do not fit.
    """
    seen = seen_skin(board, points, untouched(board, press_folders(presses, only)[0]))
    pressed = read_presses(presses, board, seen.openings, lambda done: progress(0.7 * done), only=only)
    return fit_seen(board, seen, pressed, lambda done: progress(0.7 + 0.3 * done))


class SeenSkin(NamedTuple):
    """The lens, the openings that it sees, and the untouched weighted picture (h, w)."""

    view: TubeView
    openings: Openings
    rest: Array


def seen_skin(board: Board, points: Array, rest: Array) -> SeenSkin:
    """Fit the lens to known points and find the openings in an untouched picture (h, w, 3); raises as `fit_skin`."""
    skin = skin_of(board)
    view = fit_view(board, points)
    light = weighted(rest, skin)
    return SeenSkin(view, find_openings(board, light, view.project(lattice_mm(board))), light)


def fit_seen(board: Board, seen: SeenSkin, pressed: list[Press], progress: Progress = lambda _: None) -> SkinFit:
    """Fit force, place and reach to presses on openings that were found; raises as `fit_skin`."""
    view, openings, rest = seen
    layout = layout_of(board, openings.places_mm)
    force, places = fit_force(pressed, layout), fit_places(pressed, layout)
    progress(0.3)
    reach = fit_reach(pressed, layout, places)
    apart = max(APART_MARGIN * unexplained(pressed, layout, places, reach), APART_LEAST)
    pair = most_excess(pressed, layout, places, reach)
    progress(0.6)
    left_out = _left_out(pressed, layout, force)
    spread = spread_by_kind(left_out, board.contact.threshold_un * 1e-6, N_KINDS)
    progress(0.7)
    report = _figures(left_out) | {
        "accuracy_of_presses": _of_fewer(pressed, layout, force, lambda done: progress(0.7 + 0.3 * done)),
        "n_presses": len(pressed), "n_taxels": openings.n_taxels,
        "f_px": view.f, "d_mm": view.d, "k1": view.k1, "k2": view.k2, "points_rmse_px": view.rmse_px,
        "memory": [{"part": float(g), "time_s": t} for g, t in zip(force.parts, TIMES_S, strict=True)],
        "pitch_mm": 1e-3 * min(board.markers.pitch_x_um, board.markers.pitch_y_um) if board.markers else float("nan"),
        "sink_over_height": force.sink, "hug": force.hug, "apart": apart, "pair": pair,
        "coverage": coverage(board, pressed), "n_at_rim": n_at_rim(pressed, layout),
        "load_n": [float(f(p.force_n.max() for p in pressed)) for f in (min, max)],
    }  # fmt: skip
    return SkinFit(view, openings, layout, force, places, reach, apart, pair, spread, report, openings.base_q2(rest))


def coverage(board: Board, presses: list[Press]) -> float:
    """Part of CELLS x CELLS parts of the skin in which something was pressed."""
    half_mm = np.array([board.pad.size_x_um, board.pad.size_y_um]) * 5e-4
    cell = np.clip((np.array([p.place_mm for p in presses]) / half_mm + 1) / 2 * CELLS, 0, CELLS - 1).astype(int)
    return len(np.unique(cell, axis=0)) / CELLS**2


def n_at_rim(presses: list[Press], layout: Layout) -> int:
    """How many presses sink a taxel at a rim of the skin most."""
    hardest = [sinks(press)[press.force_n.argmax()].argmax() for press in presses]
    return int((rims(layout, 0) | rims(layout, 1))[hardest].sum())


def _left_out(presses: list[Press], layout: Layout, whole: ForceFit) -> Errors:
    """Errors of presses that were left out of a fit to the others, each once."""
    n_folds = min(N_FOLDS, len(presses))
    if n_folds < 2:
        raise InputError("one press cannot be fitted and judged: give several places")
    parts = []
    for fold in range(n_folds):
        others = [p for i, p in enumerate(presses) if i % n_folds != fold]
        numbers = np.arange(fold, len(presses), n_folds)
        left = [presses[i] for i in numbers]
        of_fold = errors(left, layout, fit_force(others, layout, whole), fit_places(others, layout))
        parts.append(of_fold._replace(press=numbers[of_fold.press]))
    return Errors.joined(parts)


def _figures(left_out: Errors) -> dict[str, Any]:
    load, away = left_out.load_n, left_out.away_mm
    hard = load > HARD_N
    part, light = np.abs(left_out.off_n / load)[hard], np.abs(left_out.off_n)[~hard]
    return {
        "force_error_percent": float(100 * part.mean()) if len(part) else float("nan"),
        "force_rms_percent": float(100 * np.sqrt(np.mean(part**2))) if len(part) else float("nan"),
        "light_force_rms_n": float(np.sqrt(np.mean(light**2))) if len(light) else LIGHT_N,
        "place_error_mm": float(away.mean()),
    }


def _of_fewer(presses: list[Press], layout: Layout, whole: ForceFit, progress: Progress) -> list[dict[str, Any]]:
    def error(used: Numbers, left: Numbers) -> Figures:
        some, others = [presses[i] for i in used], [presses[i] for i in left]
        found = _figures(errors(others, layout, fit_force(some, layout, whole), fit_places(some, layout)))
        return {name: found[name] for name in ("force_error_percent", "place_error_mm")}

    return accuracy_of_presses(len(presses), error, progress)


def _sigma(spread: Spread) -> tuple[int, int, int, int]:
    """As the firmware keeps it: uN, Q12, um, um, each within its limits."""
    force_un = max(round(spread.force_n * 1e6), 1)
    place_um = max(round(spread.place_mm * 1e3), 1)
    return force_un, min(round(spread.force_part * 4096), 4096), place_um, round(spread.faint_place_mm * 1e3)


def taxel_file(board: Board, fit: SkinFit) -> CalibrationFile:
    """The calibration of taxels, signed with the development key."""
    lsb_n = board.field.force_lsb_un * 1e-6
    ratio = np.arange(RATIO_SIZE) * RATIO_STEP / 4096 - 1
    u = np.log1p(np.maximum(ratio, -0.95))
    layout = fit.layout
    cubic = fit.places.shift_mm * 1e3 * 256
    markers = board.markers
    assert markers is not None
    sigma = np.array([_sigma(spread) for spread in fit.spread], dtype=np.int32)
    tensors: Tensors = {
        "skin.run": fit.openings.runs,
        "skin.light": fit.light_q2,
        "skin.sink": np.round(u * 4096).astype(np.int32),
        "skin.press": np.round(fit.force.press(u) / lsb_n).astype(np.int32),
        "skin.reach": np.round(fit.reach * 16384).astype(np.int16),
        "skin.taxel_place": np.round(fit.places.places_mm * 1e3).astype(np.int32),
        "skin.taxel_kind": gain_kinds(layout).astype(np.int16),
        "skin.gain": np.round(fit.force.gain.table * 65536).astype(np.int32),
        "skin.sigma": sigma,
        "skin.taxel_near": layout.near.astype(np.int16),
        "skin.taxel_shift": np.round(cubic).astype(np.int32),
        "relaxation.part": np.round(fit.force.parts * 2**20).astype(np.int32),
        "relaxation.time_ms": np.round(np.array(TIMES_S) * 1e3).astype(np.int32),
    }
    numbers = {
        "skin.taxels": fit.openings.n_taxels, "skin.patches": fit.openings.n_patches,
        "skin.runs": len(fit.openings.runs),
        "skin.reach_step_um": round(REACH_STEP_MM * 1e3),
        "skin.taxel_area_um2": markers.pitch_x_um * markers.pitch_y_um,
        "skin.floor_q12": round(FLOOR * 4096), "skin.apart_q12": min(round(fit.apart * 4096), 4096),
        "skin.pair_q12": min(round(fit.pair * 4096), 1 << 20),
        **dict(zip(SIGMA_KEYS, (int(v) for v in sigma.max(axis=0)), strict=True)),
        "skin.stray_limit_q6": STRAY_LIMIT_Q6,
        "relaxation.terms": len(TIMES_S),
    }  # fmt: skip
    return pack(tensors, {**base_metadata(board), **{k: str(v) for k, v in numbers.items()}})
