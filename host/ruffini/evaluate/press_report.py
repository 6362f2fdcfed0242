"""Ball presses, each judged by a table that was fitted without it: one HTML page that needs no other file, and JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.report.html import Page
from ruffini.estimators.photometric import intensity
from ruffini.estimators.photometric.fit import MOVED_AT_MOST, PhotometricFit, Samples, models_without, tabulate
from ruffini.estimators.photometric.fitted import PressFit
from ruffini.estimators.photometric.presses import FITTED_INSIDE, Press, PressSet
from ruffini.evaluate.photometric import EQUATOR, INSIDE, REFIT_PX, Surface, evaluate, summary
from ruffini.evaluate.pictures import press_depths, press_errors
from ruffini.files import write_whole
from ruffini.frames import read_image

Tables = dict[str, npt.NDArray[Any]]
DOUBTFUL_MARK_PX = 3.0  # beyond what a hand is off by


def write_report(
    path: Path, presses: PressSet, fit: PressFit, board: Board, progress: Callable[[float], None] = lambda _: None
) -> list[Path]:
    """Judge every press by a table of the others; write `path` (HTML) and the same with ending .json."""
    result, surfaces = judge_left_out(presses, fit, board, progress)
    data = path.with_suffix(".json")
    _page(presses, surfaces, result).write(path)
    write_whole(data, (json.dumps(result, indent=1) + "\n").encode())
    return [path, data]


def judge_left_out(
    presses: PressSet, fit: PressFit, board: Board, progress: Callable[[float], None] = lambda _: None
) -> tuple[dict[str, Any], list[Surface]]:
    """The result for JSON, and what the device made of each press."""
    rows: list[dict[str, Any]] = []
    surfaces = []
    n = len(presses.presses)
    result: dict[str, Any] = {}
    for i, (tables, press) in enumerate(zip(_tables(presses, fit), presses.presses, strict=True)):
        file = container.pack(tables, {**container.base_metadata(board), **fit.metadata})
        result, seen = evaluate(replace(presses, presses=[press]), file, board, [], [])
        sample = fit.samples[i] if fit.samples else None
        rows.append({**result["presses"][0], **_facts(presses, press, sample, fit)})
        surfaces += seen
        progress((i + 1) / n)
    result |= {
        "n_presses": n, "presses": rows, "marked": summary(rows, "marked"), "refitted": summary(rows, "refitted"),
        "judged_by": "a table fitted on all other presses" if n > 1 else "the table that it was fitted on",
        "left_out": _left_out(rows, n, fit), "fit": fit.report,
    }  # fmt: skip
    del result["untouched"]
    return result, surfaces


def _tables(presses: PressSet, fit: PressFit) -> Iterator[Tables]:
    """For each press the tables of the others; of a single press its own."""
    if isinstance(fit.kind, PhotometricFit):
        yield from (tabulate(model) for model in models_without(fit.samples, fit.kind.model.choice))
        return
    everything = presses.presses
    for i in range(len(everything)):
        others = everything[:i] + everything[i + 1 :] or everything
        yield intensity.fit_intensity(replace(presses, presses=others)).tabulate()


def _facts(presses: PressSet, press: Press, sample: Samples | None, fit: PressFit) -> dict[str, Any]:
    """What the picture and its mark are like: clipped pixels, the light's level, where the fit has the centre."""
    image = read_image(press.path)
    rows, columns = np.indices(image.shape[:2])
    inside = np.hypot(columns - press.center_x_px, rows - press.center_y_px) < INSIDE * press.radius_px
    facts: dict[str, Any] = {"clipped_share": float((image[inside] >= 255).any(axis=1).mean())}
    if sample is not None and isinstance(fit.kind, PhotometricFit):
        shift = fit.kind.model.shift_px(sample, FITTED_INSIDE, MOVED_AT_MOST * sample.ball_px)
        facts |= {"light_bgr": sample.level.tolist(), "mark_off_px": float(np.hypot(*shift))}
    return facts


def _left_out(rows: list[dict[str, Any]], n: int, fit: PressFit) -> list[str]:
    """What does not count, and why."""
    kind = fit.kind
    fitted = kind.model.choice.fitted_inside() if isinstance(kind, PhotometricFit) else intensity.FITTED_INSIDE
    out = [f"Pixels beyond {fitted:.2f} (fit) and {INSIDE:.2f} (judgement) of the contact radius: the gel "
           "leaves the ball there, and nobody knows its slope.", "Pixels under printed dots."]  # fmt: skip
    equator = [row["image"] for row in rows if row["at_equator"]]
    if equator:
        out.append(f"Heights of {', '.join(equator)}: marked at {EQUATOR:.2f} of the ball's radius or more, where the "
                   "surface is upright and no camera sees its slope.")  # fmt: skip
    doubtful = [
        f"{row['image']} ({row['mark_off_px']:.1f} px)" for row in rows if row.get("mark_off_px", 0) > DOUBTFUL_MARK_PX
    ]
    if doubtful:
        out.append(
            f"Nothing of presses whose mark is doubtful, further than {DOUBTFUL_MARK_PX:.0f} px from where the fit has "
            f"the ball: {', '.join(doubtful)}. The fit moves them; they are judged near the mark."
        )
    if n == 1:
        out.append("No press was left out: there is one, and it is judged by the table that was fitted on it.")
    return out


def _page(presses: PressSet, surfaces: list[Surface], result: dict[str, Any]) -> Page:
    page = Page(f"Ball presses of {result['board']}: {result['judged_by']}")
    best, marked = result["refitted"], result["marked"]
    page.text(
        f"{result['n_presses']} presses of a ball of {presses.ball_mm:g} mm, {presses.px_per_mm:g} px/mm; circles "
        f"{result['circles']}; {result['source']}. Judged inside {INSIDE:.2f} of the contact radius, on the circle as "
        f"{result['circles']} and on the one within {REFIT_PX:.0f} px that the normals agree with best."
    )
    names = {"normal_median_deg": "normals, median, degrees", "normal_worst_deg": "normals, worst",
             "cap_median_mm": "cap shape, median, mm RMS", "cap_worst_mm": "cap shape, worst",
             "peak_to_edge_median": "peak to edge, median", "peak_to_edge_least": "peak to edge, least",
             "peak_to_edge_most": "peak to edge, most"}  # fmt: skip
    page.table(["", result["circles"], "refitted"], [[words, marked[key], best[key]] for key, words in names.items()])
    page.heading("Best, middling and worst press")
    page.picture(press_errors(presses, surfaces, result), "pictures with circles, error of the normals")
    page.picture(press_depths(presses, surfaces, result), "depth and profile")
    page.heading("Every press")
    page.table(*_rows(result))
    page.heading("Left out")
    for words in result["left_out"]:
        page.text(words)
    page.heading("What was tried")
    tried = result["fit"].get("tried", {})
    page.table(["model", "normals left out, degrees"], [[name, value] for name, value in tried.items()])
    return page


def _rows(result: dict[str, Any]) -> tuple[list[str], list[list[Any]]]:
    """The table of presses."""
    head = ["image", "normals, deg", "refitted", "cap, mm", "refitted", "peak to edge", "refitted", "dx, dy, dr px",
            "clipped, %", "light B, G, R, %", "mark off, px", ""]  # fmt: skip
    rows: list[list[Any]] = []
    for row in result["presses"]:
        cells: list[Any] = [row["image"]]
        for key in ("normal_deg", "cap_rms_mm", "peak_to_edge"):
            cells += [row["marked"][key], row["refitted"][key]]
        cells.append(" ".join(f"{v:+.2f}" for v in row["correction_px"]))
        cells.append(100 * row["clipped_share"])
        cells.append(" ".join(f"{100 * v:+.1f}" for v in row.get("light_bgr", [])))
        cells += [row.get("mark_off_px", ""), "at the equator" if row["at_equator"] else ""]
        rows.append(cells)
    return head, rows
