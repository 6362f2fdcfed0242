"""What a run of `ruffini cal auto` came to: one HTML page, and one table of many runs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ruffini.calibrate.gates import Gate
from ruffini.calibrate.report.html import Page
from ruffini.calibrate.report.page import gate_table
from ruffini.errors import InputError

STEPS = {"balls": "ball presses, for the colours", "fitted": "touches that it is fitted to",
         "judged": "judged touches, before and after"}  # fmt: skip
LEAST_SHOWN_S = 3.0
SHOWN = {
    "error": "error", "force_rmse_n": "force, N RMS", "force_worst_n": "worst touch, N", "largest_force_n": "up to, N",
    "normal_rmse_n": "normal force, N RMS", "shore_rmse": "hardness, Shore A RMS",
    "place_mm": "place off by, mm", "untold": "touches not told", "touches": "touches",
}  # fmt: skip


def write_auto_page(path: Path, result: dict[str, Any]) -> None:
    """The error before and after first; then what it took."""
    mark = ", SIMULATED" if result["simulated"] else ""
    page = Page(f"cal auto: {result['board']}{mark}")
    page.verdict(headline(result), is_good=result["passed"])
    page.text(f"Judged on {result['after']['touches']} touches that nothing was fitted to, against "
              f"{result['after']['against']}. Calibration {result['sha256'][:12]} is in force; `ruffini cal undo` puts "
              "back what was before.")  # fmt: skip
    page.heading("Judged touches")
    columns = [key for key in SHOWN if key in result["after"]]
    head = [result["unit"] if key == "error" else SHOWN[key] for key in columns]
    rows = [(name, *(_cell(result[name].get(key)) for key in columns)) for name in ("before", "after") if result[name]]
    page.table(("", *head), rows)
    if "axes_rmse_n_nm" in result["after"]:
        page.heading("Axis by axis, RMS")
        axes = ("Fx, mN", "Fy, mN", "Fz, mN", "Tx, N mm", "Ty, N mm", "Tz, N mm")
        page.table(("", *axes), [
            (name, *(1e3 * v if v == v else "not measured" for v in result[name]["axes_rmse_n_nm"]))
            for name in ("before", "after") if result[name]
        ])  # fmt: skip
    page.heading("What it took")
    page.table(
        ("", "touches"), [(text, result["presses"][key]) for key, text in STEPS.items() if result["presses"][key]]
    )
    steps = [(name, f"{s / 60:.1f}") for name, s in result["seconds"].items() if s >= LEAST_SHOWN_S]
    page.table(("step", "minutes"), steps)
    page.text(clock_text(result["clock"]))
    gate_table(page, [Gate(**gate) for gate in result["gates"]])
    page.link("report.html", "How the calibration errs on the touches that it was fitted to")
    page.write(path)


def headline(result: dict[str, Any]) -> str:
    """Before and after, in one line."""
    after = f"{result['after']['error']:.3g} {result['unit']}"
    if result["before"] is None:
        return f"off by {after}; nothing was measured before"
    return f"off by {result['before']['error']:.3g} before, now by {after}"


def clock_text(clock: dict[str, Any] | None) -> str:
    """How well the two clocks were found."""
    if clock is None:
        return "Clocks: collected in several runs, so their true offset is not known."
    if "why_not" in clock:
        return f"Clocks: no offset found: {clock['why_not']}"
    return (f"Clocks: their offset was found {clock['error_ms']:+.1f} ms off the twin's, stated "
            f"+-{clock['sigma_ms']:.1f} ms.")  # fmt: skip


def _cell(value: Any) -> Any:
    return "-" if value is None else value


def table_of(folders: list[Path]) -> tuple[list[dict[str, Any]], str]:
    """Results of runs, and one line of Markdown for each.

    Raises
    ------
    InputError
        A folder holds no finished run.
    """
    results = []
    for folder in folders:
        try:
            results.append(json.loads((folder / "result.json").read_text()))
        except (OSError, ValueError) as error:
            raise InputError(f"{folder} holds no finished run of `cal auto`: give its --out ({error})") from error
    lines = ["| board | presses (colours, fit, judged twice) | minutes | error before | after | clocks |",
             "| --- | --- | --- | --- | --- | --- |"]  # fmt: skip
    for r in results:
        presses = ", ".join(str(r["presses"][key]) for key in STEPS)
        before = "not measured" if r["before"] is None else f"{r['before']['error']:.3g}"
        clock = r["clock"] or {}
        offset = f"{clock['error_ms']:+.1f} ms (+-{clock['sigma_ms']:.1f})" if "error_ms" in clock else "not known"
        quick = " `--quick`" if r.get("quick") else ""
        place = f", place {r['after']['place_mm']:.2f} mm" if r["after"].get("place_mm") else ""
        lines.append(f"| {r['board']}{quick} | {presses} | {sum(r['seconds'].values()) / 60:.0f} | {before} | "
                     f"{r['after']['error']:.3g} {r['unit']}{place} | {offset} |")  # fmt: skip
    return results, "\n".join(lines)
