"""`cal fit --only photometric` on a folder of presses: which kind of skin, the fit, its tables and words."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.estimators.photometric.change import Rest
from ruffini.estimators.photometric.find_discs import is_monochrome
from ruffini.estimators.photometric.fit import PhotometricFit, Samples, collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.intensity import IntensityFit, fit_intensity
from ruffini.estimators.photometric.pad_view import PadView, pad_view
from ruffini.estimators.photometric.presses import PressSet
from ruffini.frames import read_image

SOURCES = ("auto", "colour", "intensity")
LEAST_PRESSES = 3  # of colours, which have tens of numbers to fit
LOOKED_AT = 5  # pictures that tell which kind of skin this is


@dataclass(frozen=True)
class PressFit:
    """A fit of either kind; `samples` only of colours."""

    kind: PhotometricFit | IntensityFit
    tensors: dict[str, npt.NDArray[Any]]
    report: dict[str, Any]
    summary: str
    metadata: dict[str, str] = field(default_factory=dict)
    samples: list[Samples] = field(default_factory=list)


def fit_presses(
    presses: PressSet, board: Board, *, is_foreign: bool, source: str = "auto", view: PadView | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> PressFit:  # fmt: skip
    """Fit the presses of a unit; `view`: its camera as measured, where that was done.

    Raises
    ------
    InputError
        Pictures of other optics than the board's, too few presses, an unknown source.
    """
    if source not in SOURCES:
        raise InputError(f"--source {source!r}: give one of {', '.join(SOURCES)}")
    camera = board.camera
    height, width = presses.reference.shape[:2]
    if not is_foreign and (width, height) != (camera.width_px, camera.height_px):
        raise InputError(
            f"{presses.presses[0].path.parent}: images are {width}x{height}, board {board.name!r} has "
            f"{board.resolution}: give --foreign if they come from other optics"
        )
    metadata = {"optics": "foreign"} if is_foreign else {}
    is_of_depth = source == "intensity" or (source == "auto" and _darkens(presses))
    if is_of_depth:
        dark = fit_intensity(presses)
        report = {**dark.report(), **presses.circle_report(), **_plausible(presses, board, is_foreign)}
        held_out = report["held_out_cap_rms_mm"]
        left_out = "none was left out" if held_out is None else f"left out {held_out:.4f} mm"
        summary = (
            f"brightness to depth: cap {report['fitted_cap_rms_mm']:.4f} mm RMS as fitted, {left_out} "
            f"({report['n_presses']} presses, {presses.circle_text()}){presses.skipped_text()}"
        )
        return PressFit(dark, dark.tabulate(), report, summary, metadata)
    if len(presses.presses) < LEAST_PRESSES:
        raise InputError(
            f"{presses.presses[0].path.parent}: {len(presses.presses)} presses: at least {LEAST_PRESSES} are needed"
        )
    samples = collect_samples(presses, None if is_foreign else view or pad_view(board, {}, {}))
    fit = fit_photometric(samples, progress=progress)
    plausible = _plausible(presses, board, is_foreign)
    report = {"source": "colour", **fit.report(), **presses.circle_report(), **plausible}
    summary = (
        f"normals of presses left out of the fit: median {report['held_out_normal_median_deg']:.2f} deg, worst press "
        f"{report['held_out_normal_worst_deg']:.2f} deg ({report['n_presses']} presses, {presses.circle_text()})"
        f"{presses.skipped_text()}"
    )
    return PressFit(fit, tabulate(fit.model), report, summary, metadata, samples)


def _plausible(presses: PressSet, board: Board, is_foreign: bool) -> dict[str, Any]:
    """What gates compare with the board, and the number of places that were pressed."""
    scale = board.camera.focal_mpx / board.camera.standoff_um
    return {
        "n_places": presses.n_places(), "ball_mm": presses.ball_mm,
        "scale_of_board": None if is_foreign else round(presses.px_per_mm / scale, 4),
    }  # fmt: skip


def _darkens(presses: PressSet) -> bool:
    step = max(len(presses.presses) // LOOKED_AT, 1)
    rest = Rest(presses.reference)
    images = [read_image(p.path).astype(np.float64) for p in presses.presses[::step]]
    return all(i.shape == presses.reference.shape for i in images) and is_monochrome([rest.change(i) for i in images])
