"""Parts that the HTML reports of calibrations have in common."""

from __future__ import annotations

import json
from typing import Any

from ruffini.calibrate.container import CalibrationFile
from ruffini.calibrate.gates import Gate, failed
from ruffini.calibrate.log.warmth import celsius_rows
from ruffini.calibrate.report.fewer_presses import accuracy_text
from ruffini.calibrate.report.html import Page

AXES = ("Fx, N", "Fy, N", "Fz, N", "Tx, N mm", "Ty, N mm", "Tz, N mm")


def report_head(file: CalibrationFile, tree: dict[str, Any], gates: list[Gate], judged: str) -> Page:
    """A page that says what is judged on what (`judged`: how many touches, pictures, frames), the gates, the stages."""
    log, calibration = tree["log"], tree["calibration"]
    page = Page(f"Calibration of {tree['board']}" + (", SIMULATED" if log["simulated"] else ""))
    bad = failed(gates)
    page.verdict("FAILS: " + "; ".join(g.name for g in bad) if bad else "Passes its gates", is_good=not bad)
    known = "the log that it was fitted to" if log["in_the_fit"] else "a log that it was not fitted to"
    page.text(f"{calibration['sha256'][:12]}, made {calibration.get('created_utc')}, {', '.join(file.kinds)}; "
              f"judged on {judged} of {known} ({', '.join(log['files'])})")  # fmt: skip
    gate_table(page, gates)
    stage_table(page, file)
    return page


def fewer_presses_table(page: Page, rows: list[dict[str, Any]]) -> None:
    """What fewer presses would have been worth, where the fit of the file told it."""
    if rows:
        page.heading("Accuracy against the number of presses")
        page.table(("presses", "judged on the others"), [tuple(accuracy_text(row).split(" presses: ")) for row in rows])


def range_table(page: Page, names: dict[str, str], valid_for: dict[str, Any]) -> None:
    """What a log tried; `names` of its lines but the temperatures'."""
    rows: list[tuple[Any, ...]] = [(name, *valid_for[key]) for key, name in names.items() if key in valid_for]
    page.table(("", "from", "to"), rows + celsius_rows(valid_for["temperature_c"]))


def gate_table(page: Page, gates: list[Gate]) -> None:
    """Each gate with its verdict."""
    page.heading("Gates")
    words = {True: ("ok", "ok"), False: ("FAILS", "bad"), None: ("not judged", "open")}
    page.table(("", "gate", "what"), [(words[g.ok][0], g.name, g.text) for g in gates],
               [words[g.ok][1] for g in gates])  # fmt: skip


def stage_table(page: Page, file: CalibrationFile) -> None:
    """What the stages of the fit said."""
    try:
        stages = json.loads(file.metadata.get("residuals", "{}")).get("stages", {})
    except (ValueError, AttributeError):
        return
    if stages:
        page.heading("Stages of the fit")
        page.table(("stage", "", "what it found"), [(name, s["state"], s["text"]) for name, s in stages.items()])


def about(file: CalibrationFile) -> dict[str, Any]:
    """What a file says of itself, and what it is."""
    keys = ("created_utc", "tool_version", "sensor_serial", "gel_serial", "optics", "operator.material")
    return {
        "sha256": file.sha256.hex(),
        "kinds": file.kinds,
        **{k: file.metadata[k] for k in keys if k in file.metadata},
    }
