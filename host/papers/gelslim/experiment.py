"""The dense force field's experiment: ten states, five objects and a rigid-soft ball, by us and by iFEM raw and 2.0.

Every method is given the same noisy surface displacement (`displacement_noise_um` of reproduce.toml). Ours is what the
board's integers make of it, second pass included; the paper's is `method`, plain hexahedra, each ridge's weight chosen
on other states. The paper prints no figure.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from papers.drawing import METHOD, OURS, TRUTH, plots, save
from papers.experiments import Experiment, Figure, Options
from papers.gelslim.bench import errors, last_frame, paper_methods
from papers.gelslim.shear_reference import compliance_at_nodes, reference_error
from papers.judged import default_folder
from papers.recorded import Recorded, recorded_runs, shape_of
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.operator.error_model import N_TOUCHES
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise
from ruffini.sim.reproduce.make import digest
from ruffini.sim.reproduce.make import reproduce as record
from ruffini.sim.reproduce.settings import PressSet, load_reproduce
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]

METHODS = ("ours", "raw", "ridge")
RESTS = ("tangential", "normal", "resultant", "shear_over_normal")
STRAIGHT = 0.1  # shear over force of a press whose shear is near the noise
CORED = {"rigid_soft": "it slides", "rigid_soft_held": "it sticks"}  # the rigid-soft ball of Fig. 1
RING_MM = 0.5  # of the profile of shear over radius
LEAST_NODES = 4  # in a ring that counts


def reproduce(board: Board, out: Path, options: Options) -> Experiment:
    """Record what is missing, reconstruct, judge, draw."""
    folder = (options.folder or default_folder(board).parent) / f"{board.name}-{digest(board)[:12]}"
    quick, n_workers = options.quick, options.n_workers
    record(board, folder, quick=quick, n_workers=n_workers, progress=lambda p: options.progress(0.6 * p))
    runs = recorded_runs(board, folder, quick=options.quick)
    raw, ridge, weight = paper_methods(board, runs)
    options.progress(0.7)
    rows, cored = [], {}
    with _pipeline(board) as ours:
        for run in (r for r in runs if r.part != "fit"):
            displacement, force = last_frame(run)
            found = {
                "ours": _as_the_board(ours, board, displacement),
                "raw": (raw @ displacement.ravel()).reshape(force.shape),
                "ridge": (ridge @ displacement.ravel()).reshape(force.shape),
            }
            scores = {name: dict(zip(RESTS, errors(f, force), strict=True)) for name, f in found.items()}
            rows.append({"state": _name(run), "part": run.part, **scores})
            if run.set_name in CORED:
                cored[run.set_name] = _rigid_soft(board, run, {"truth": force, **found})
    options.progress(0.95)
    result: dict[str, Any] = {
        "simulated": True, "board": board.name, "quick": options.quick, "ridge_weight": weight, "states": rows,
        "cored": cored, "reference": _reference(board, runs),
    }  # fmt: skip
    return Experiment(result, _text(result), _draw(out, cored), figures(result))


def _pipeline(board: Board) -> Pipeline:
    noise = Noise(tuple(1e-6 * um for um in load_reproduce(board).rig.displacement_noise_um))  # type: ignore[arg-type]
    kind = make_operator(board, method="support", noise=noise, n_touches=N_TOUCHES)
    return Pipeline(board, container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data)


def _as_the_board(core: Pipeline, board: Board, displacement: Array) -> Array:
    steps = np.clip(np.round(displacement / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)
    force = core.solve(steps.reshape(1, -1, 3)).reshape(displacement.shape)
    return np.asarray(force * (board.field.force_lsb_un * 1e-6))


def _name(run: Recorded) -> str:
    return shape_of(run) if run.set_name == "objects" else run.set_name


def _reference(board: Board, runs: list[Recorded]) -> dict[str, float]:
    """Error of `shear_reference` on the shown objects that are pressed straight."""
    shown = {_name(run): last_frame(run) for run in runs if run.part == "show"}
    straight = {n: s for n, s in shown.items() if np.linalg.norm(s[1][..., :2]) < STRAIGHT * np.linalg.norm(s[1])}
    if not straight:
        return {}
    compliance = compliance_at_nodes(TwinUnit.build(board))
    noise_m = 1e-6 * np.array(load_reproduce(board).rig.displacement_noise_um, dtype=float)
    return {name: reference_error(board, compliance, noise_m, *state) for name, state in straight.items()}


def _rigid_soft(board: Board, run: Recorded, found: dict[str, Array]) -> dict[str, Any]:
    """Fig. 1: mean tangential nodal force in rings about the contact's middle, N; inner over outer half."""
    settings = run.run.settings
    assert isinstance(settings, PressSet)
    pad, grid = board.pad, board.grid
    x = (np.arange(grid.n_x) / (grid.n_x - 1) - 0.5) * pad.size_x_um * 1e-3
    y = (np.arange(grid.n_y) / (grid.n_y - 1) - 0.5) * pad.size_y_um * 1e-3
    pressure = np.maximum(-found["truth"][..., 2], 0)
    middle_x, middle_y = (pressure * x).sum() / pressure.sum(), (pressure * y[:, None]).sum() / pressure.sum()
    away = np.hypot(x - middle_x, y[:, None] - middle_y)
    touched = pressure > 0.02 * pressure.max()
    edges = np.arange(0, away[touched].max() + RING_MM, RING_MM)
    ring = np.digitize(away, edges) - 1
    kept = [i for i in range(len(edges) - 1) if ((ring == i) & touched).sum() >= LEAST_NODES]
    shear = {name: np.linalg.norm(force[..., :2], axis=-1) for name, force in found.items()}
    profile = {name: [float(s[(ring == i) & touched].mean()) for i in kept] for name, s in shear.items()}
    half = 0.5 * away[touched].max()
    core = {n: float(s[touched & (away < half)].mean() / s[touched & (away >= half)].mean()) for n, s in shear.items()}
    truth = np.array(profile["truth"])
    error = {n: float(np.linalg.norm(np.array(v) - truth) / np.linalg.norm(truth)) for n, v in profile.items()}
    return {"radius_mm": [float(edges[i] + RING_MM / 2) for i in kept], "shear_n": profile,
            "inner_over_outer": core, "error": error}  # fmt: skip


def figures(result: dict[str, Any]) -> dict[str, Figure]:
    """Those of wanted.toml: means over the ten states, errors of each object, the rigid-soft ball."""
    out: dict[str, Figure] = {}
    states = [row for row in result["states"] if row["part"] == "judge"]
    for what, name in (("tangential", "tangential field"), ("normal", "normal field"), ("resultant", "resultant")):
        ours, ridge = (float(np.mean([row[m][what] for row in states])) for m in ("ours", "ridge"))
        out[f"ten states, {name}"] = Figure(ours, ridge)
    first = states[0]
    out["shear over normal of S1"] = Figure(*(first[m]["shear_over_normal"] for m in ("ours", "ridge")))
    for row in result["states"]:
        if row["part"] == "show":
            for what in RESTS[:2]:
                out[f"{row['state']}, {what} field"] = Figure(row["ours"][what], row["ridge"][what])
    for name, ball in result["cored"].items():
        out[f"{name}, shear over radius"] = Figure(ball["error"]["ours"], ball["error"]["ridge"])
        middle = ball["inner_over_outer"]
        out[f"{name}, inner over outer shear"] = Figure(middle["ours"], middle["ridge"])
    return out


def _text(result: dict[str, Any]) -> str:
    head = ("state", *(f"{m}: {what}" for m in METHODS for what in ("tangential", "normal", "resultant")))
    cells = [
        (row["state"], *(f"{row[m][what]:.3g}" for m in METHODS for what in ("tangential", "normal", "resultant")))
        for row in result["states"]
    ]
    quick = ", quick" if result["quick"] else ""
    lines = [
        f"{result['board']}: relative L2 error of nodal forces, SIMULATED{quick}; the ridge's weight "
        f"{result['ridge_weight']:g}",
        *aligned(head, cells, "  "),
    ]
    for name, error in result["reference"].items():
        lines.append(
            f"  {name}, tangential: {error:.2f} by an estimator that knows mechanics, normal force and contact"
        )
    for name, ball in result["cored"].items():
        each = ", ".join(f"{method} {value:.2f}" for method, value in ball["inner_over_outer"].items())
        lines.append(f"  {name} (Fig. 1), shear of the contact's inner over its outer half: {each}")
    return "\n".join(lines)


def _draw(out: Path, cored: dict[str, Any]) -> list[Path]:
    out.mkdir(parents=True, exist_ok=True)
    if not cored:
        return []
    figure, axes = plots().subplots(1, len(cored), figsize=(5 * len(cored), 4), squeeze=False)
    for axis, (set_name, ball) in zip(axes[0], cored.items(), strict=True):
        for name, colour in (("truth", TRUTH), ("ours", OURS), ("ridge", METHOD)):
            axis.plot(ball["radius_mm"], 1e3 * np.array(ball["shear_n"][name]), "o-", color=colour, label=name)
        axis.set_title(CORED[set_name])
        axis.set_xlabel("from the middle of the contact, mm")
    axes[0, 0].set_ylabel("tangential force of a node, mN")
    axes[0, 0].legend()
    return [save(figure, out / "rigid_soft.png", "Rigid-soft ball, sheared (Fig. 1)")]
