"""Every table of the fingertip's experiment, for a person."""

from __future__ import annotations

from typing import Any

from papers.stereo_fingertip import teacher as stereo_teacher
from ruffini.estimators.fingertip.area import FLAT_MM

QUANTITIES = ("force_n", "z_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg", "area_percent")
TESTS = ("force", "full-scale error", "X", "Y", "Z", "angle of 45")
SURE_MM = 1.0  # stated deviation of a place that is called known


def text(result: dict[str, Any]) -> str:
    """Every table."""
    lines = [f"{result['board']}: fingertip, mean absolute errors, SIMULATED", ""]
    head = f"  {'':26}{'frames':>7}{'told %':>8}" + "".join(f"{q:>13}" for q in QUANTITIES)
    lines += ["unseen tools, sizes, places, angles and seeds", head]
    for name, row in result["unseen"].items():
        lines += _lines(name, row)
    lines += ["", "X and Y of a tool followed while it presses, mm"]
    for name, axes in result["followed"].items():
        for axis, levels in axes.items():
            lines.append(f"  {name:10}{axis:6}" + ", ".join(f"{level} {value:.2f}" for level, value in levels.items()))
    lines += ["", "the same set `any` with one eye", head]
    for name, row in result["one_eye"].items():
        lines += _lines(f"{name} eye alone", row)[:1]
    lines += ["", "stand-in for the paper's network, fitted on the same presses, set `any`"]
    for mode, row in result["stand_in"].items():
        lines.append(f"  {'input mode ' + mode:41}" + "".join(f"{v:13.3f}" for v in row.values()))
    if "teacher" in result:
        lines += stereo_teacher.text(result["teacher"])
    lines += _tests(result["paper_tests"], result["published"])
    lines += ["", f"Table 6: area of the face, %{'':6}{'whole':>9}{'partial':>9}{'paper':>9}"]
    for tool, row in result["area"].items():
        told = f"told in {row['n_whole']} of {row['of_whole']} and {row['n_partial']} of {row['of_partial']} frames"
        lines.append(f"  {tool:32}{row['whole']:9.1f}{row['partial']:9.1f}{row['paper']:9.3f}  {told}")
    lines += [
        "",
        f"direct area, in the tool's plane to {FLAT_MM:g} mm, mm^2: from the pins, of the true wall, mean error",
    ]
    for row in result["direct_area"]:
        areas = f"{row['ours_mm2']:9.1f}{row['true_mm2']:9.1f}{row['mean_error_mm2']:9.1f}"
        lines.append(
            f"  {row['from_n']:g}-{row['to_n']:g} N{'':20}{areas}  {row['n']} frames, faces of {row['face_mm2']:.0f}"
        )
    apart = result["told_apart"]
    if apart:
        noise = f"noise {apart['noise_px']:.4f} px"
        lines += ["", f"deviations between pictures and those of a disc of 5 mm at X = 0 ({noise})"]
        lines.append(f"  {'true force, N':16}" + "".join(f"{v:8.2f}" for v in apart["force_n"]))
        lines += [f"  {name:16}" + "".join(f"{v:8.1f}" for v in row) for name, row in apart["deviations"].items()]
        least = apart["least_mm"]
        if least:
            values = "".join(f"{v:8.2f}" for v in least)
            lines.append(f"  {'X at best, mm':16}{values}  together {sum(least) / len(least):.2f}")
    ms = result["frame_ms"]
    times = f"{ms['median']:.2f} ms, 99 of 100 below {ms['p99']:.1f} ms, longest {ms['most']:.1f} ms"
    lines += ["", f"processor time of a frame: {times}"]
    return "\n".join(lines)


def _tests(tests: dict[str, Any], published: dict[str, float]) -> list[str]:
    if not tests:
        return []
    lines = ["", f"the paper's tests {'':16}{'ours':>9}{'paper':>9}"]
    for name in TESTS:
        lines.append(f"  {name:32}{tests[name]:9.3f}" + (f"{published[name]:9.3f}" if name in published else ""))
    lines.append("  Table 5, force of each test, N: " + ", ".join(f"{e:.4f}" for e in tests["force_of_each_test"]))
    lines.append(
        "  full-scale error of each test, %: " + ", ".join(f"{e:.2f}" for e in tests["full_scale_of_each_test"])
    )
    for name, quantity in (("X", "x_mm"), ("Y", "y_mm"), ("Z", "z_mm"), ("angle", "roll_deg")):
        by = ", ".join(f"{level} N {row[quantity]:.3f}" for level, row in tests[f"{name}_by_force"].items())
        lines.append(f"  {name} by force: {by}")
    for name, what in (("a1", "force, N"), ("a2", "X, mm"), ("a3", "Y, mm")):
        lines += ["", f"Table {name.upper()}: true force: {what} estimated (error), frame by frame"]
        for row in tests[f"table_{name}"]:
            cells = zip(row["force_n"], row["estimated"], row["error"], strict=True)
            label = "" if name == "a1" else f"{row['true']:+.0f} mm "
            lines.append(f"  {label}" + "  ".join(f"{f:.2f}: {e:.2f} ({o:.2f})" for f, e, o in cells))
    return lines


def _lines(name: str, row: dict[str, Any]) -> list[str]:
    if not row["n_frames"]:
        return [f"  {name:26}{0:7d}"]
    out = [f"  {name:26}{row['n_frames']:7d}{row['told_percent']:8.1f}"
           + "".join(f"{row['mean'][q]:13.3f}" for q in QUANTITIES)]  # fmt: skip
    for level, means in row["by_force"].items():
        out.append(f"    {level + ' N':39}" + "".join(f"{means[q]:13.3f}" for q in QUANTITIES))
    sure = row["sure_of_place"]
    where = f"x {sure['x_mm']:.2f}, y {sure['y_mm']:.2f} mm"
    for k in (1, 2):
        inside = "".join(f"{row['stated'][q][f'within_{k}']:13.1f}" for q in QUANTITIES)
        out.append(f"    {f'within {k} stated sigma, %':39}{inside}")
    out.append(
        f"    place stated to {SURE_MM:g} mm in {sure['percent']:.0f} %: {where}; "
        f"area told in {row['area_told_percent']:.0f} %"
    )
    return out
