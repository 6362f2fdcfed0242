"""Newtons from rendered frames, judged on presses and pads that nothing was fitted on. SIMULATED.

Four pads whose E, Poisson's ratio and thickness are each 3 % off the board's numbers, in four combinations of signs.
Of each pad, colours come from its own ball presses and E, Poisson's ratio and thickness from `cal fit --only material`
on a log of other presses; nothing is given. Judged: balls of 4-8 mm and flats of 3-6 mm, 0.3-1.0 mm deep, all sheared,
half turned. Then where the error comes from: the same frames solved again with one part of the displacement, or the
material, replaced by the truth. `--development` plays other seeds, for whoever looks for something better. `--network`
judges a network of `ruffini train displacement` on the same frames, with the same operator in float64. `--nodes-of`
judges the same forces once more, added up on another board's nodes: finer nodes show finer errors.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.interpolate import RectBivariateSpline

from ruffini.bench.ifem import Scores
from ruffini.bench.states import Recipe, State
from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, Pipeline
from ruffini.estimators.material.fit import fit_material, log_from_recording
from ruffini.estimators.operator.fit import Material, OperatorKind, board_slab, make_operator, second_pass
from ruffini.estimators.operator.gauge import gauge_uncertainty_m
from ruffini.estimators.operator.marker_lattice import NodesOnLattice, marker_places
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.fem.operators import Noise
from ruffini.frames import read_frames
from ruffini.sim import programs
from ruffini.sim.recording import PadError, TwinUnit, record_balls, record_touches
from ruffini.train.predict import DisplacementNetwork

sys.path.insert(0, str(Path(__file__).parents[1] / "bitexact"))
from mirror.path import FramePath as MirrorPath

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int16]

OFF = 0.03
SIGNS = ((1, 1, -1), (-1, 1, 1), (1, -1, 1), (-1, -1, -1))  # of E, Poisson's ratio, thickness
JUDGED_SEED, DEVELOPMENT_SEED = 20_270_115, 880_001
N_BALLS, BALL_MM = 32, 5.0
N_LOG = 16  # touches with a reference wrench, for the material
READING, FLOOR_N = 0.02, 0.05
WANTED = {"tangential": 0.20, "normal": 0.15}
SIGMA_M, TILT_M = (5e-6, 5e-6, 20e-6), 30e-6  # the defaults of cal operator
STRONG = 0.1  # frames above this part of the largest force are compared with float64
AXES = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
ANY = Recipe("press", ())
MEASURED = "as measured"
NETWORK = "trained network, float"
NETWORK_FILE = Path(__file__).parents[2] / "out" / "train"  # BOARD/displacement.onnx: judged where it is there


@dataclass
class Frames:
    """The judged frames of one pad: what the core made of the pictures, and the truth (metres, newtons)."""

    u: Integers  # (k, n_y, n_x, 3), steps of the displacement
    steps: npt.NDArray[np.int32]  # the field
    wrench: Array
    true_u: Array
    true_force: Array
    true_wrench: Array
    frame_ms: list[float]
    sum_difference_un: int
    network_u: Array | None = None  # (k, n_y, n_x, 3), metres


@dataclass
class Row:
    """One way to solve the judged frames."""

    scores: Scores = field(default_factory=Scores)
    over_wanted: list[float] = field(default_factory=list)  # error of the resultant over what is wanted

    def add(self, truth: Array, force: Array, step_mm: tuple[float, float]) -> None:
        for true, found in zip(truth, force, strict=True):
            state = State(ANY, 0.0, true, np.zeros_like(true))
            self.scores.add(state, found, step_mm)
            self.over_wanted.append(self.scores.resultant_n[-1] / (READING * state.resultant_n + FLOOR_N))

    def summary(self) -> dict[str, float]:
        means, over = self.scores.means(), np.array(self.over_wanted)
        return {
            "tangential": means["tangential"], "normal": means["normal"], "resultant_n": means["resultant_n"],
            "within_percent": float(100 * np.mean(over <= 1)), "worst_over_wanted": float(over.max()),
        }  # fmt: skip


@dataclass
class Total:
    """Everything over all pads."""

    rows: dict[str, Row] = field(default_factory=dict)
    wrench_error: list[Array] = field(default_factory=list)
    displacement_error_um: dict[str, list[Array]] = field(default_factory=dict)  # rms of each pad's touched nodes
    gauge_um: list[float] = field(default_factory=list)  # mean error of u_z, of each frame
    frame_ms: list[float] = field(default_factory=list)
    float_error: list[float] = field(default_factory=list)
    material_percent: list[list[float]] = field(default_factory=list)
    sum_difference_un: int = 0
    mirror_frames: int = 0
    mirror_differs: int = 0


def calibrate(unit: TwinUnit, folder: Path, seed: int) -> dict[str, Any]:
    """Tables of one pad's own colours."""
    record_balls(unit, N_BALLS, folder, ball_mm=BALL_MM, seed=seed)
    c = unit.board.camera
    camera = Pinhole(c.focal_mpx / 1e3, c.center_x_mpx / 1e3, c.center_y_mpx / 1e3, c.standoff_um / 1e3)
    return tabulate(fit_photometric(collect_samples(load_presses(folder), camera)).model)


def packed(board: Board, kind: OperatorKind, colours: dict[str, Any]) -> container.CalibrationFile:
    """A calibration file of a solve and colours."""
    return container.pack({**kind.tensors, **colours}, {**container.base_metadata(board), **kind.metadata})


def play(board: Board, file: container.CalibrationFile, recording: Path) -> Frames:
    """Run a recording through the core and keep the frames that its truth marks."""
    truth = np.load(recording / "truth.npz")
    judged = truth["judged"]
    u, steps, wrench, frame_ms, difference_un = [], [], [], [], 0
    with Pipeline(board, file.data) as pipeline:
        for i, image in enumerate(read_frames(recording)):
            frame = pipeline.process(image)
            field_steps = pipeline.raw("force")
            total = field_steps.astype(np.int64).sum(axis=(0, 1)) * board.field.force_lsb_un
            difference_un = max(difference_un, int(np.abs(total - frame.wrench_un[:3]).max()))
            if judged[i]:
                u.append(pipeline.raw("displacement"))
                steps.append(field_steps)
                wrench.append(frame.wrench)
                frame_ms.append(sum(frame.stage_ns.values()) * 1e-6)
    return Frames(
        np.array(u), np.array(steps), np.array(wrench), truth["displacement"][judged], truth["force"][judged],
        truth["wrench"][judged], frame_ms, difference_un,
    )  # fmt: skip


def network_displacement(board: Board, network: Path, recording: Path) -> Array:
    """What a trained network makes of the judged frames; rest is the mean of the untouched first ones."""
    judged = np.load(recording / "truth.npz")["judged"]
    frames = list(read_frames(recording))
    net = DisplacementNetwork(network, board, np.mean(frames[: board.pipeline.n_rest_frames], axis=0))
    return np.array([net.displacement_m(frames[i]) for i in np.flatnonzero(judged)])


def solved(pipeline: Pipeline, u: Integers) -> Array:
    """Nodal forces of displacements as the board computes them, newtons."""
    steps = pipeline.solve(np.ascontiguousarray(u.reshape(len(u), -1, 3)))
    return np.asarray(steps.reshape(u.shape) * (pipeline.board.field.force_lsb_un * 1e-6))


def in_steps(u_m: Array) -> Integers:
    return np.clip(np.round(u_m / DISPLACEMENT_LSB_M), -32767, 32767).astype(np.int16)


def seen_at_markers(board: Board, u: Array) -> Array:
    """True displacement at the lattice, taken to the nodes as the board does."""
    assert board.markers is not None
    x, y = marker_places(board, board.markers)
    node_x = (np.arange(board.grid.n_x) / (board.grid.n_x - 1) - 0.5) * board.pad.size_x_um * 1e-6
    node_y = (np.arange(board.grid.n_y) / (board.grid.n_y - 1) - 0.5) * board.pad.size_y_um * 1e-6
    at = np.stack([RectBivariateSpline(node_y, node_x, u[..., c])(y, x) for c in range(3)], axis=-1)
    return NodesOnLattice(board, board.markers).interpolate(at)


def routes(board: Board, frames: Frames) -> dict[str, Integers]:
    """Displacements in which one source of error at a time is off."""
    true, seen = in_steps(frames.true_u), frames.u
    depth_off = (seen - true)[..., 2].mean(axis=(1, 2), keepdims=True)
    gauged = seen.copy()
    gauged[..., 2] = np.round(seen[..., 2] - depth_off)
    ideal = in_steps(np.array([seen_at_markers(board, u) for u in frames.true_u]))
    sideways, depth = np.s_[..., :2], np.s_[..., 2:]
    return {
        MEASURED: seen,
        "true depth": np.concatenate([seen[sideways], true[depth]], axis=-1),
        "true mean depth (gauge)": gauged,
        "true sideways": np.concatenate([true[sideways], seen[depth]], axis=-1),
        "true sideways, at the markers only": np.concatenate([ideal[sideways], seen[depth]], axis=-1),
        "all true": true,
    }


def step_mm(board: Board) -> tuple[float, float]:
    pad, grid = board.pad, board.grid
    return pad.size_x_um * 1e-3 / (grid.n_x - 1), pad.size_y_um * 1e-3 / (grid.n_y - 1)


def is_whole(board: Board) -> bool:
    """Whether each node of the pad is observed."""
    return board.observed == (slice(0, board.grid.n_y), slice(0, board.grid.n_x))


def added_up(board: Board, nodes_of: Board, force: Array) -> Array:
    """Nodal forces (k, n_y, n_x, 3) on the nodes of another board's grid over the same pad, by bilinear shares.

    Force and moment stay what they are.
    """

    def shares(n_here: int, n_there: int) -> Array:
        here, there = np.linspace(0, 1, n_here), np.linspace(0, 1, n_there)
        return np.array([np.interp(here, there, one) for one in np.eye(n_there)])

    along_y, along_x = shares(board.grid.n_y, nodes_of.grid.n_y), shares(board.grid.n_x, nodes_of.grid.n_x)
    return np.einsum("yj,kjic,xi->kyxc", along_y, force, along_x, optimize=True)


def judge(
    board: Board, frames: Frames, own: OperatorKind, files: dict[str, container.CalibrationFile], into: Total,
    nodes_of: Board | None = None,
) -> None:  # fmt: skip
    """Add one pad; `files`: of the fitted, the board's and the true material."""

    def add(name: str, force: Array) -> None:
        into.rows.setdefault(name, Row()).add(frames.true_force, force, step_mm(board))
        if nodes_of is not None:
            truth, found = (added_up(board, nodes_of, f) for f in (frames.true_force, force))
            row = into.rows.setdefault(f"{name}, {nodes_of.name}'s nodes", Row())
            row.add(truth, found, step_mm(nodes_of))

    with Pipeline(board, files["fitted"].data) as pipeline:
        for name, u in routes(board, frames).items():
            add(name, frames.steps * (board.field.force_lsb_un * 1e-6) if name == MEASURED else solved(pipeline, u))
    for name in ("true material", "the board's material"):
        with Pipeline(board, files[name].data) as pipeline:
            add(name, solved(pipeline, frames.u))
            if name == "true material":
                add("all true, true material", solved(pipeline, in_steps(frames.true_u)))
    check_integers(board, frames, own, files["fitted"], into)
    into.wrench_error += list(frames.wrench - frames.true_wrench)
    touched = frames.true_force[..., 2] < -1e-6 * board.contact.threshold_un
    displacements = {MEASURED: frames.u * DISPLACEMENT_LSB_M}
    if frames.network_u is not None:
        assert own.support is not None
        estimate = second_pass(board, own.matrix, own.support)
        add(NETWORK, np.array([estimate(u)[0] for u in frames.network_u]))
        displacements[NETWORK] = frames.network_u
    for name, u_m in displacements.items():
        square_um = ((u_m - frames.true_u)[touched] * 1e6) ** 2
        into.displacement_error_um.setdefault(name, []).append(np.sqrt(square_um.mean(axis=0)))
    error_um = (frames.u * DISPLACEMENT_LSB_M - frames.true_u) * 1e6
    into.gauge_um += error_um[..., 2].mean(axis=(1, 2)).tolist()
    into.frame_ms += frames.frame_ms
    into.sum_difference_un = max(into.sum_difference_un, frames.sum_difference_un)


def check_integers(
    board: Board, frames: Frames, own: OperatorKind, file: container.CalibrationFile, into: Total
) -> None:
    """The field against float64 from the same displacement, and against the numpy mirror."""
    assert own.support is not None
    estimate = second_pass(board, own.matrix, own.support)
    mirror = MirrorPath(board.model_dump(exclude_none=True), file.tensors, file.metadata)
    strong = STRONG * max(float(np.linalg.norm(w[:3])) for w in frames.true_wrench)
    for u, steps, wrench in zip(frames.u, frames.steps, frames.true_wrench, strict=True):
        reference, _ = estimate(u * DISPLACEMENT_LSB_M)
        if np.linalg.norm(wrench[:3]) > strong:
            off = np.linalg.norm(steps * (board.field.force_lsb_un * 1e-6) - reference)
            into.float_error.append(float(off / np.linalg.norm(reference)))
        into.mirror_differs += not np.array_equal(
            mirror.solve(u.reshape(-1, 3).astype(np.int64))[0], steps.reshape(-1, 3)
        )
        into.mirror_frames += 1


def noise_of(board: Board, material: Material | None = None) -> Noise:
    """As `cal fit --only operator` takes it without options."""
    return Noise(SIGMA_M, gauge_m=gauge_uncertainty_m(board, material), tilt_m=TILT_M)


def run_pad(
    board: Board, believed: OperatorKind, number: int, n_presses: int, seed: int, network: Path | None, folder: Path,
    into: Total, nodes_of: Board | None,
) -> None:  # fmt: skip
    """Simulate, calibrate and judge one pad."""
    error = PadError(*(1 + OFF * s for s in SIGNS[number]))
    unit = TwinUnit.build(board, error)
    seed += 10 * number
    colours = calibrate(unit, folder / "balls", seed)
    log_story = programs.grid(board, N_LOG, np.random.default_rng(seed + 3))
    record_touches(unit, log_story, folder / "log", seed=seed + 4, program="grid")
    story = programs.sheared_and_turned(board, n_presses, np.random.default_rng(seed + 5))
    record_touches(unit, story, folder / "touches", seed=seed + 6, program="sheared_and_turned")
    log = log_from_recording(board, packed(board, believed, colours), folder / "log", None, progress=lambda _: None)
    fitted = fit_material(board, log, noise_of(board)).material
    slab = board_slab(board)
    true = Material(slab.modulus_pa * error.modulus, slab.poisson * error.poisson, slab.thickness_m * error.thickness)
    into.material_percent.append([100 * (f / t - 1) for f, t in zip(fitted, true, strict=True)])
    own = make_operator(board, method="support", noise=noise_of(board, fitted), material=fitted)
    ideal = make_operator(board, method="support", noise=noise_of(board, true), material=true)
    files = {
        name: packed(board, kind, colours)
        for name, kind in (("fitted", own), ("true material", ideal), ("the board's material", believed))
    }
    frames = play(board, files["fitted"], folder / "touches")
    if network is not None:
        frames.network_u = network_displacement(board, network, folder / "touches")
    judge(board, frames, own, files, into, nodes_of)


def summary(total: Total) -> dict[str, Any]:
    return {
        "simulated": True,
        "presses": len(total.wrench_error),
        "rows": {name: row.summary() for name, row in total.rows.items()},
        "wrench_rmse": dict(zip(AXES, np.sqrt((np.array(total.wrench_error) ** 2).mean(axis=0)).tolist(), strict=True)),
        "displacement_rms_um": {k: np.mean(v, axis=0).tolist() for k, v in total.displacement_error_um.items()},
        "gauge_um": [float(np.mean(total.gauge_um)), float(np.std(total.gauge_um))],
        "material_percent": total.material_percent,
        "frame_ms_median": float(np.median(total.frame_ms)),
        "sum_difference_un": total.sum_difference_un,
        "fixed_vs_float64_worst": max(total.float_error),
        "mirror_frames": total.mirror_frames,
        "mirror_frames_that_differ": total.mirror_differs,
    }


def tables(board: Board, s: dict[str, Any]) -> str:
    camera = board.camera
    lines = [
        f"{board.name}, SIMULATED, {s['presses']} presses on {len(s['material_percent'])} pads, E, nu and thickness "
        f"{100 * OFF:.0f} % off, fitted by cal material; colours from ball presses",
        f"whole frame {camera.width_px}x{camera.height_px}, difference to contacts: {s['frame_ms_median']:.2f} ms "
        "median, one core",
        f"{'':52}{'tangential':>11}{'normal':>8}{'resultant':>12}{'within':>8}{'worst':>7}",
    ]
    lines += [
        f"  {name:50}{r['tangential']:11.3f}{r['normal']:8.3f}{1e3 * r['resultant_n']:9.1f} mN"
        f"{r['within_percent']:6.0f} %{r['worst_over_wanted']:7.2f}"
        for name, r in s["rows"].items()
    ]
    mean, spread = s["gauge_um"]
    lines += [
        f"  wanted: tangential <= {WANTED['tangential']}, normal <= {WANTED['normal']}, resultant within "
        f"{100 * READING:.0f} % of reading + {FLOOR_N} N (worst: error over that)",
        *(
            f"  displacement of touched nodes off by {x:.1f}, {y:.1f}, {z:.1f} um rms, {name}"
            for name, (x, y, z) in s["displacement_rms_um"].items()
        ),
        f"  mean depth off by {mean:+.1f} +- {spread:.1f} um",
        "  wrench rmse: " + ", ".join(f"{axis} {1e3 * v:.1f}" for axis, v in s["wrench_rmse"].items()) + " mN and N mm",
        "  fitted E, nu, thickness off by: "
        + "; ".join("/".join(f"{v:+.1f}" for v in pad) + " %" for pad in s["material_percent"]),
        f"  field against wrench: sums differ by {s['sum_difference_un']} uN; fixed point against float64: worst "
        f"{100 * s['fixed_vs_float64_worst']:.3f} % (wanted <= 0.5 %); core against numpy mirror: "
        f"{s['mirror_frames_that_differ']} of {s['mirror_frames']} solves differ",
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--board", default="gelslim")
    parser.add_argument("--presses", type=int, default=25, help="on each pad")
    parser.add_argument("--pads", type=int, choices=range(1, len(SIGNS) + 1), default=len(SIGNS), help="how many")
    parser.add_argument("--development", action="store_true", help="presses that are not judged")
    parser.add_argument("--network", type=Path, help="displacement.onnx (default: out/train/BOARD's, if it is there)")
    parser.add_argument("--nodes-of", metavar="BOARD", help="judge on this board's nodes, too")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the table")
    arguments = parser.parse_args()
    board = find_board(arguments.board)
    network = arguments.network or NETWORK_FILE / board.name / "displacement.onnx"
    if arguments.network is None and not network.is_file():
        network = None
    nodes_of = None if arguments.nodes_of is None else find_board(arguments.nodes_of)
    if nodes_of is not None and not (is_whole(board) and is_whole(nodes_of)):
        parser.error("--nodes-of: both boards must see all of their pad")
    if nodes_of is not None and (nodes_of.pad.size_x_um, nodes_of.pad.size_y_um) != (
        board.pad.size_x_um, board.pad.size_y_um,
    ):  # fmt: skip
        parser.error(f"--nodes-of {nodes_of.name}: its pad has another size than {board.name}'s")
    if nodes_of is not None and (nodes_of.grid.n_x > board.grid.n_x or nodes_of.grid.n_y > board.grid.n_y):
        parser.error(
            f"--nodes-of {nodes_of.name}: its nodes are finer than {board.name}'s: give a board with coarser ones"
        )
    believed = make_operator(board, method="support", noise=noise_of(board))
    seed = DEVELOPMENT_SEED if arguments.development else JUDGED_SEED
    total = Total()
    with tempfile.TemporaryDirectory(prefix="ruffini-accuracy-") as scratch:
        for number in range(arguments.pads):
            folder = Path(scratch) / str(number)
            run_pad(board, believed, number, arguments.presses, seed, network, folder, total, nodes_of)
            print(f"pad {number + 1} of {arguments.pads} done", file=sys.stderr)
    s = summary(total)
    print(json.dumps(s) if arguments.json else tables(board, s))
    broken = s["fixed_vs_float64_worst"] > 0.005 or s["sum_difference_un"] or s["mirror_frames_that_differ"]
    sys.exit(1 if broken or s["rows"][MEASURED]["within_percent"] < 95 else 0)


if __name__ == "__main__":
    main()
