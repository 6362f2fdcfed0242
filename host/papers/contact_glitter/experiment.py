"""The contact-model paper's experiments: Fig. 4 to 6, Table I, depth, hardness, objects, wear; ours and its own method.

Ours is fitted on presses.toml and says what the core says of each frame, with the calibration in force. The paper's
method is fitted on what the paper fits on. Both are judged on the paper's bench, of which nothing is in our fit: sizes,
hardnesses and seeds are others, and the place of its test. Against the truth, and of forces against the bench's
reference as well, whose sideways channels are mostly its own errors.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.contact_glitter import pictures
from papers.contact_glitter.bench import SHAPES
from papers.contact_glitter.bench import judge as judge_method
from papers.contact_glitter.depth import by_bench
from papers.contact_glitter.hardness_bound import bounds
from papers.contact_glitter.played import Played
from papers.experiments import Experiment, Figure, Options
from papers.judged import default_folder
from papers.recorded import Recorded, each_played, recorded_runs
from papers.stated import Coverage, coverage, covered, deviations
from papers.stated import lines as stated_lines
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core import Pipeline
from ruffini.estimators.contact_model.log import HERTZIAN, read_presses
from ruffini.estimators.contact_model.tables import fit_contact, tables
from ruffini.estimators.wrench.log import features_of, zero_of
from ruffini.estimators.wrench.model import AXES, TO_NMM
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.make import reproduce as record

Array = npt.NDArray[np.float64]

BENCH = "presses.toml"
BANDS = ((20, 40), (40, 60), (60, 80))
PAPER_DEPTH_MM, PAPER_SHORE = 0.2, 7.656
PAPER = {"triangle": (1.080, 1.326, 0.076), "flat": (1.470, 1.882, 0.132), "square": (1.662, 1.234, 0.118),
         "sphere": (1.574, 0.498, 0.041)}  # fmt: skip
VALID = 1
HARD = 90.0  # Shore A, of Fig. 4 and 5
FACTOR_UM = 1400
LIMIT_MM, RANGE_MM = 4.0, 2.5  # of the paper's limit press; beyond the second its force is wrong (section V-A)
N_FIRST = 10
PLANAR_KIND = 1
NORMAL = 2  # in a wrench
UNMARKED_SIGMAS, UNMARKED_PART, FULL_SCALE_N = 5.0, 0.05, 70.0  # beyond both, a valid force is wrong without saying so


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Record what is missing, fit, judge, draw."""

    def within(begin: float, end: float) -> Callable[[float], None]:
        return lambda done: options.progress(begin + (end - begin) * done)

    parent, quick, n = options.folder or default_folder(board).parent, options.quick, options.n_workers
    own = parent / f"{board.name}-{digest(board, BENCH)[:12]}"
    paper = parent / f"{board.name}-{digest(board)[:12]}"
    record(board, own, bench=BENCH, quick=quick, n_workers=n, progress=within(0.0, 0.3))
    record(board, paper, quick=quick, n_workers=n, progress=within(0.3, 0.5))
    presses = read_presses([own], board, progress=within(0.5, 0.6))
    fit = fit_contact(board, presses, within(0.6, 0.8))
    tensors, metadata = tables(board, fit, features_of(board))
    file = container.pack(tensors, {**container.base_metadata(board), **metadata})
    container.write(out / "contact.safetensors", file)
    runs = recorded_runs(board, paper, quick=quick)
    shown = [r for r in runs if r.part != "fit" or r.set_name == "calibration"]
    played = each_played(lambda run: play(board, file.data, run), shown, options.n_workers, within(0.8, 0.9))
    method = judge_method(board, runs)
    result = judge(board, played, method)
    known = [p for p in presses if p.has_model]
    result |= {"calibration": fit.report(), "bounds": bounds(known, fit.model),
               "press_bounds": bounds(known, fit.model, of_press=True),
               "by_bench": by_bench(board, presses, paper), "quick": quick}  # fmt: skip
    return Experiment(result, text_of(result), pictures.draw(out, played, result), figures(result, method))


def figures(result: dict[str, Any], method: dict[str, float]) -> dict[str, Figure]:
    """Those of wanted.toml. Depth and hardness by a log as a bench has it, and by one told the twin's gel surface."""
    out: dict[str, Figure] = {}
    for name, row in result["forces"].items():
        by_method = method.get(f"tangential force, {name}"), method.get(f"moment, {name}")
        out |= {
            f"normal force, {name}": Figure(row["fn"], row.get("fn_method"), row.get("fn_paper")),
            f"tangential force, {name}": Figure(row["ft"], by_method[0], row.get("ft_paper")),
            f"moment, {name}": Figure(row["moment"], by_method[1], row.get("moment_paper")),
        }
    bench = result["by_bench"]
    for part, what, paper in (("test", "paper's test", None), ("repeat", "smallest, hardest triangle", PAPER_DEPTH_MM)):
        told = result["depth"][what]
        if f"{part}, gel" in bench:
            out[f"depth by bench knowledge, {what}"] = Figure(bench[f"{part}, gel"], told["method"], paper)
        out[f"depth told the gel's surface, {what}"] = Figure(told["gel"], told["method"], paper)
    if "test, Shore A, told the kind" in bench:
        out["hardness by bench knowledge, told the kind"] = Figure(
            bench["test, Shore A, told the kind"], result["method_hardness_told"], PAPER_SHORE
        )
    hardness = result["hardness"]["paper's test"]
    out["hardness, 20-80"] = Figure(hardness["all"]["rmse"], result["method_hardness_told"], PAPER_SHORE)
    for kind in ("planar", "Hertzian"):
        out |= {f"hardness, {kind} {band}": Figure(row["rmse"]) for band, row in hardness[f"{kind} bands"].items()}
    out["kind inferred"] = Figure(100 * hardness["kind_right"])
    if result["objects"]:
        out["objects of Fig. 9 measured"] = Figure(sum(o["is_valid"] for o in result["objects"]))
    refused = [*result["failing"], *result["too_soft"]]
    if refused:
        out["H, T, nut and Shore A 5 refused"] = Figure(sum(not o["is_valid"] for o in refused))
    out |= {
        f"refused at left-out sizes, {shape}": Figure(100 * parts["sizes"])
        for shape, parts in result["calibration"]["refused"].items()
        if "sizes" in parts
    }
    out["wrong without a mark"] = Figure(result["unmarked"]["unmarked"])
    out |= {name: Figure(percent) for name, percent in covered(result["stated"], ("Fz", "depth", "hardness")).items()}
    return out


def play(board: Board, calibration: bytes, recorded: Recorded) -> Played:
    """One run through the core."""
    at, first = recorded.touched, int(recorded.touched[0])
    wrench, rows, is_valid, sigma, fall = [], [], [], [], []
    with Pipeline(board, calibration) as core:
        for i in range(int(at[-1]) + 1):
            frame = core.process(recorded.picture(i))
            if i >= first:
                wrench.append(frame.wrench)
                rows.append(core.modelled())
                is_valid.append(np.array(frame.wrench_validity) == VALID)
                sigma.append(deviations(core.covariance()))
                fall.append(core.profile().fall_q16 / 65536)
    force = recorded.rig["force"]
    return Played(recorded, np.array(wrench), recorded.truth["wrench"][at], force[at] - zero_of(force[:first]), rows,
                  np.array(is_valid), np.array(sigma), np.array(fall))  # fmt: skip


def judge(board: Board, played: list[Played], method: dict[str, float]) -> dict[str, Any]:
    """Every table."""
    sets: dict[str, list[Played]] = {}
    for p in played:
        sets.setdefault(p.recorded.set_name, []).append(p)
    test, shear = sets.get("test", []), sets.get("test_shear", [])
    objects = [p for name, part in sets.items() if name.startswith("object_") for p in part]
    return {
        "board": board.name, "simulated": True, "published_depth_mm": PAPER_DEPTH_MM, "published_shore_a": PAPER_SHORE,
        "forces": _forces([*test, *shear], method),
        "depth": {
            "smallest, hardest triangle": {**_depth(sets.get("repeat", [])), "method": method.get("depth", np.nan)},
            "paper's test": {**_depth(test), "method": method.get("depth, all shapes and sizes", np.nan)},
            "moved sideways": _depth(shear),
        },
        "hardness": {"paper's test": _hardness(test), "objects of Fig. 9": _hardness(objects)},
        "method_hardness_told": method.get("hardness", np.nan),
        "method_hardness_alone": method.get("hardness, from the sensor alone", np.nan),
        "objects": [_told(p) for p in objects], "failing": [_told(p) for p in sets.get("failing", [])],
        "too_soft": [_told(p) for p in sets.get("too_soft", [])], "wear": _wear(sets.get("durability", [])),
        "unmarked": _unmarked(played), "limit": _limit(played), "stated": _stated(test, shear),
        "resolution": _resolution(sets.get("repeat", [])), "factors": _factors(sets.get("calibration", [])),
    }  # fmt: skip


def rms(values: Iterable[Array] | Array) -> float:
    """Root mean square of all numbers; NaN of none."""
    all_ = np.concatenate([np.atleast_1d(v) for v in values]) if not isinstance(values, np.ndarray) else values
    return float(np.sqrt(np.mean(all_**2))) if all_.size else float("nan")


def _side(force: Array) -> Array:
    return np.asarray(np.hypot(force[:, 0], force[:, 1]))


def _forces(played: list[Played], method: dict[str, float]) -> dict[str, dict[str, float]]:
    """Table I by shape. As of the paper's method, Fn over straight presses alone; `fn_sheared` over the others."""
    rows: dict[str, dict[str, float]] = {}
    for shape, name in SHAPES.items():
        runs = [p for p in played if p.shape == shape]
        if not runs:
            continue
        straight = [p for p in runs if not p.recorded.set_name.endswith("shear")] or runs
        row = {
            "largest": max(float(-p.truth[:, 2].min()) for p in runs),
            "fn": rms([p.wrench[:, 2] - p.truth[:, 2] for p in straight]),
            "fn_reference": rms([p.wrench[:, 2] - p.reference[:, 2] for p in straight]),
            "fn_sheared": rms([p.wrench[:, 2] - p.truth[:, 2] for p in runs if p not in straight]),
            "ft": rms([_side(p.wrench - p.truth) for p in runs]),
            "moment": rms([p.wrench[:, 5] - p.truth[:, 5] for p in runs]),
            "moment_by_flow": rms([p.of("moment_by_flow_unmm") * 1e-9 - np.abs(p.truth[:, 5]) for p in runs]),
        }
        if method:
            row |= {"fn_method": method[f"normal force, {name}"], "fn_paper": PAPER[shape][0],
                    "ft_paper": PAPER[shape][1], "moment_paper": PAPER[shape][2]}  # fmt: skip
            row["part"] = row["fn_reference"] / row["fn_method"]
        rows[name] = row
    return rows


def _depth(played: list[Played]) -> dict[str, float]:
    """RMSE, mm, of the gel's depth and of the press depth."""
    return {
        "gel": rms([p.of("gel_depth_um") * 1e-3 - p.gel_mm for p in played]),
        "press": rms([
            p.of("press_depth_um") * 1e-3 - p.recorded.truth["pose"][p.recorded.touched, 2] * 1e3 for p in played
        ]),
        "area_percent": 100 * rms([
            p.of("area_um2") * 1e-12 / p.recorded.rig["area_m2"][p.recorded.touched] - 1 for p in played
        ]),
        "frames": float(sum(len(p.rows) for p in played)),
    }  # fmt: skip


def _told(p: Played) -> dict[str, Any]:
    return {
        "shape": p.shape, "radius_mm": p.radius_mm, "shore_a": p.shore_a, "told": p.told.shore_q4 / 16,
        "off": p.told.shore_q4 / 16 - p.shore_a, "sigma": p.told.shore_sigma_q4 / 16,
        "kind": p.told.kind, "sure": p.told.sure_1e3 * 1e-3,
        "is_valid": p.told.hardness_validity == VALID, "stiffness_n_mm3": p.told.stiffness_pa_um * 1e-3,
        "fn_rmse": rms([p.wrench[:, 2] - p.truth[:, 2]]), "gel_mm": _depth([p])["gel"],
    }  # fmt: skip


def _hardness(played: list[Played]) -> dict[str, Any]:
    """Errors of presses told valid, with the kind inferred; by band, shape and size."""
    rows = [_told(p) for p in played]
    told = [r for r in rows if r["is_valid"]]
    sizes = sorted({r["radius_mm"] for r in told})

    def error(part: list[dict[str, Any]]) -> dict[str, float]:
        return {"rmse": rms(np.array([r["told"] - r["shore_a"] for r in part])), "n": float(len(part))}

    return {
        "presses": len(rows), "told": len(told), "all": error([r for r in told if 20 <= r["shore_a"] <= 80]),
        "bands": {f"{a}-{b}": error([r for r in told if a <= r["shore_a"] < b]) for a, b in BANDS},
        "planar bands": {f"{a}-{b}": error([r for r in told if a <= r["shore_a"] < b and r["shape"] not in HERTZIAN])
                         for a, b in BANDS},
        "Hertzian bands": {f"{a}-{b}": error([r for r in told if a <= r["shore_a"] < b and r["shape"] in HERTZIAN])
                           for a, b in BANDS},
        "shapes": {s: error([r for r in told if r["shape"] == s]) for s in SHAPES},
        "sizes": {f"{size:g}": error([r for r in told if r["radius_mm"] == size]) for size in sizes},
        "kind_right": _share((r["kind"] == PLANAR_KIND) != (r["shape"] in HERTZIAN) for r in told),
        "within_2_sigma": _share(abs(r["told"] - r["shore_a"]) <= 2 * r["sigma"] for r in told),
    }  # fmt: skip


def _unmarked(played: list[Played]) -> dict[str, float]:
    """Valid normal forces beyond 5 sigma and 5 % of full scale; root mean square of error over sigma."""
    valid = [p.is_valid[:, NORMAL] for p in played]
    error = np.concatenate([(p.wrench - p.truth)[v, NORMAL] for p, v in zip(played, valid, strict=True)])
    sigma = np.concatenate([p.sigma[v, NORMAL] for p, v in zip(played, valid, strict=True)])
    is_wrong = np.abs(error) > np.maximum(UNMARKED_SIGMAS * sigma, UNMARKED_PART * FULL_SCALE_N)
    return {"frames": float(len(error)), "unmarked": float(is_wrong.sum()), "error_over_sigma": rms(error / sigma),
            "worst_over_sigma": float(np.abs(error / sigma).max(initial=0.0))}  # fmt: skip


def _stated(straight: list[Played], sheared: list[Played]) -> dict[str, Coverage]:
    """Of the paper's test: forces in N, moment in N mm, depth in mm, Shore A of the kind inferred."""
    out: dict[str, Coverage] = {}
    for name, runs in (("", straight), (", sheared", sheared)):
        if not runs:
            continue
        error = np.concatenate([np.where(p.is_valid, p.wrench - p.truth, np.nan) for p in runs]) * TO_NMM
        sigma = np.concatenate([p.sigma for p in runs]) * TO_NMM
        axes = (AXES[0], AXES[1], AXES[2], AXES[5]) if name else AXES[2:3]
        out |= {f"{axis}{name}": coverage(error[:, i], sigma[:, i]) for i, axis in enumerate(AXES) if axis in axes}
        off = np.concatenate([p.of("gel_depth_um") * 1e-3 - p.gel_mm for p in runs])
        valid = np.concatenate([p.of("depth_validity") == VALID for p in runs])
        out[f"depth{name}"] = coverage(off[valid], np.concatenate([p.of("depth_sigma_um") for p in runs])[valid] * 1e-3)
    told = [row for row in map(_told, straight) if row["is_valid"]]
    off, sigma = (np.array([row[key] for row in told]) for key in ("off", "sigma"))
    return out | {"hardness": coverage(off, sigma)}


def _limit(played: list[Played]) -> dict[str, float]:
    """How far the presses went, mm, of the limit press, and how many frames are beyond the range, and told so."""
    gel = np.concatenate([p.gel_mm for p in played])
    told = np.concatenate([p.of("gel_depth_um") for p in played]) * 1e-3
    travel = max(float(p.recorded.truth["pose"][p.recorded.touched, 2].max()) for p in played)
    return {
        "wanted_mm": LIMIT_MM, "travel_mm": 1e3 * travel, "gel_mm": float(gel.max()), "told_mm": float(told.max()),
        "beyond": float((gel > RANGE_MM).sum()), "told_beyond": float((told > RANGE_MM).sum()),
    }  # fmt: skip


def _share(each: Iterable[bool]) -> float:
    all_ = list(each)
    return float(np.mean(all_)) if all_ else float("nan")


def _wear(played: list[Played]) -> dict[str, float]:
    """Error of the peak force, N, and of the peak press depth, mm: of the first ten presses and after the last."""
    if not played:
        return {}
    force = np.array([p.truth[:, 2].min() - p.wrench[:, 2].min() for p in played])
    depth = np.array([p.of("gel_depth_um").max() * 1e-3 - p.gel_mm.max() for p in played])
    return {"fn_first": rms(force[:N_FIRST]), "fn_last": float(abs(force[-1])), "gel_first": rms(depth[:N_FIRST]),
            "gel_last": float(abs(depth[-1]))}  # fmt: skip


def _resolution(played: list[Played]) -> dict[str, float]:
    """Spread of the same press made again and again, at each step of the way down: N, N m, mm, Shore A."""
    if len(played) < 2:
        return {}
    spread = {
        "fn": np.array([p.wrench[:, 2] for p in played]).std(axis=0, ddof=1),
        "moment": np.array([p.wrench[:, 5] for p in played]).std(axis=0, ddof=1),
        "gel": np.array([p.of("gel_depth_um") * 1e-3 for p in played]).std(axis=0, ddof=1),
    }
    shore = np.std([p.told.shore_q4 / 16 for p in played], ddof=1)
    return {name: float(np.median(each)) for name, each in spread.items()} | {"shore_a": float(shore)}


def _factors(played: list[Played]) -> dict[str, float]:
    """Fig. 4 to 6, why single factors fail: R2 of lines, of hardness at 1.4 mm of press depth."""
    hard = [p for p in played if p.shore_a >= HARD]
    told = [p for p in played if p.told.hardness_validity == VALID]
    rows: dict[str, float] = {}
    for kind, is_ball in (("planar", False), ("Hertzian", True)):
        some = [p for p in hard if (p.shape in HERTZIAN) == is_ball]
        rows[f"Fig. 4, depth by density, {kind}"] = _r2([p.fall for p in some], [p.gel_mm for p in some])
        of = [p for p in told if (p.shape in HERTZIAN) == is_ball]
        at = [int(np.argmin(np.abs(p.of("press_depth_um") - FACTOR_UM))) for p in of]
        shore = [np.array([p.shore_a]) for p in of]
        factors = {
            "force": [-p.wrench[i, 2:3] for p, i in zip(of, at, strict=True)],
            "depth": [p.of("gel_depth_um")[i : i + 1] for p, i in zip(of, at, strict=True)],
            "area": [p.of("area_um2")[i : i + 1] for p, i in zip(of, at, strict=True)],
            "H_m": [np.array([p.told.stiffness_pa_um]) for p in of],
            "perceptron": [np.array([p.told.shore_q4]) for p in of],
        }
        rows |= {f"Fig. 6, hardness by {name}, {kind}": _r2(values, shore) for name, values in factors.items()}
    flat = [p for p in hard if p.shape not in HERTZIAN]
    s_n = [np.sqrt(p.of("effective_area_um2") * 1e-6) * p.of("gel_depth_um") * 1e-3 for p in flat]
    rows["Fig. 5, force by S_n, all planar sizes"] = _r2(s_n, [-p.truth[:, 2] for p in flat])
    slopes = [np.array([-p.truth[:, 2] @ s / (s @ s)]) for s, p in zip(s_n, flat, strict=True)]
    rows["Fig. 5c, slope by area"] = _r2([p.of("effective_area_um2").mean(keepdims=True) for p in flat], slopes)
    return rows


def _r2(x: list[Array], y: list[Array]) -> float:
    if len(x) < 3:
        return float("nan")
    return float(np.corrcoef(np.concatenate(x), np.concatenate(y))[0, 1] ** 2)


def _lines(title: str, rows: dict[str, dict[str, float]]) -> list[str]:
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    lines = [title, "  " + " " * 28 + "".join(f"{n:>13}" for n in names)]
    for name, row in rows.items():
        lines.append(f"  {name:28}" + "".join(f"{row[n]:13.3g}" if n in row else f"{'':13}" for n in names))
    return lines


def text_of(r: dict[str, Any]) -> str:
    """The tables for a person."""
    lines = [f"{r['board']}: SIMULATED{', QUICK: fewer runs, not the figures of the README' if r['quick'] else ''}"]
    lines += _lines("Table I on the paper's test, N and N m (fn, ft, moment: against the truth)", r["forces"])
    lines += _lines("Depth, mm", r["depth"])
    for where, h in r["hardness"].items():
        lines.append(f"Hardness, {where}: {h['told']} of {h['presses']} presses told, kind inferred right in "
                     f"{100 * h['kind_right']:.0f} %, RMSE {h['all']['rmse']:.2f} over 20-80 (paper, told the "
                     f"kind: {r['published_shore_a']}), within 2 sigma {100 * h['within_2_sigma']:.0f} %")  # fmt: skip
        for part in ("bands", "planar bands", "Hertzian bands", "shapes", "sizes"):
            each = ", ".join(f"{k} {v['rmse']:.1f} ({v['n']:.0f})" for k, v in h[part].items())
            lines.append(f"  {part}: {each}")
    told, alone = r["method_hardness_told"], r["method_hardness_alone"]
    lines.append(f"Hardness by the paper's method, told the kind, force and travel: {told:.2f}; by itself: {alone:.1f}")
    each = ", ".join(f"{k} {v:.1f}" for k, v in r["bounds"].items())
    lines.append(f"Cramer-Rao bound of one frame, Shore A: {each}")
    each = ", ".join(f"{k} {v:.1f}" for k, v in r["press_bounds"].items())
    lines.append(f"Cramer-Rao bound of a press, Shore A: {each}")
    for name in ("objects", "failing", "too_soft"):
        lines += [f"{name}: {_object(each)}" for each in r[name]]
    lines.append("Fitted on what a bench knows, mm: " + ", ".join(f"{k} {v:.3g}" for k, v in r["by_bench"].items()))
    for name, parts in r["calibration"]["refused"].items():
        each = ", ".join(f"{100 * part:.0f} % of {what}" for what, part in parts.items())
        lines.append(f"no model holds for {name}: refused, not in the fit: {each}")
    far = r["limit"]
    lines.append(
        f"limit press: {far['wanted_mm']:g} mm are wanted, the twin's presses go {far['travel_mm']:.2f} mm, the gel "
        f"{far['gel_mm']:.2f} mm deep, told at most {far['told_mm']:.2f}; frames deeper than {RANGE_MM:g} mm: "
        f"{far['beyond']:.0f}, told so and flagged over range: {far['told_beyond']:.0f}"
    )
    if (depth_map := r["calibration"]["depth_map"]) is not None:
        each = ", ".join(f"{shape} {under:.3f}" for shape, under in depth_map["under_mm"].items())
        lines.append(f"depth map, presses left out of its fit, mm where they touch: {each}; "
                     f"beside {depth_map['beside_mm']['all']:.3f}")  # fmt: skip
    lines += stated_lines("Stated uncertainty, paper's test: N, N mm, mm, Shore A", r["stated"])
    for name in ("unmarked", "wear", "resolution", "factors"):
        lines.append(f"{name}: " + ", ".join(f"{k} {v:.3g}" for k, v in r[name].items()))
    return "\n".join(lines)


def _object(o: dict[str, Any]) -> str:
    valid = "" if o["is_valid"] else " (invalid)"
    return (f"{o['shape']} of {o['radius_mm']:g} mm, Shore {o['shore_a']:g}: told {o['told']:.1f} +- {o['sigma']:.1f}"
            f"{valid}, H_m {o['stiffness_n_mm3']:.4f} N/mm3, Fn off by {o['fn_rmse']:.2f} N")  # fmt: skip
