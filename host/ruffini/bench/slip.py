"""Stick and slip on the twin: a contact sheared until it slides, every node's truth known. SIMULATED.

What is judged is what the board computes (firmware/stages/contacts/slip.h) on the default operator's forces, frame by
frame, with noise on the displacement. Its constants were chosen on other radii, loads, frictions and places.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.disturbance import WHITE_UM, Disturbance
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import DISPLACEMENT_LSB_M, ContactRow, Pipeline
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise
from ruffini.sim.contact import SLIPS, ContactSolver, Indenter, Pose
from ruffini.sim.settings import load_twin
from ruffini.sim.surface import hat_areas, on_grid
from ruffini.sim.unit import PadError, TwinUnit

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

MM = 1e-3
STEP_MM = 0.02  # of the indenter's way between two frames
PRESS_FRAMES, HOLD_FRAMES, SLIDING_FRAMES = 8, 3, 12
LONGEST_MM = 2.5
GROSS = 0.97  # true slipping share from which a contact slides
STICKING = 0.3  # true slipping share below which an alarm is false
INCIPIENT, SLIDING = 2, 3  # SlipState
PAD_ERROR = PadError(modulus=1.03, poisson=1.01, thickness=0.98)


@dataclass(frozen=True)
class Case:
    """One contact, mm and degrees. `way`: "slides" (sheared until it does), "press", "back" or "rolls"."""

    shape: str
    radius: float
    depth: float
    friction: float
    heading: float
    x: float
    y: float
    way: str = "slides"

    @property
    def name(self) -> str:
        return f"{self.shape} R {self.radius:g}, {self.depth:g} mm, mu {self.friction:g}, {self.way}"


# For a pad of about 20 x 16 mm; none of these was used to choose a constant.
JUDGED = (
    Case("sphere", 4.5, 0.45, 0.35, 35, 1.2, -0.8),
    Case("sphere", 6.5, 0.55, 0.75, 190, -0.4, 0.9),
    Case("flat", 2.2, 0.35, 0.55, 75, 0.6, -0.3),
    Case("sphere", 9.0, 0.35, 0.45, 310, -1.6, 0.2),
    Case("sphere", 5.5, 0.7, 0.25, 105, 2.2, 1.4),
    Case("sphere", 3.0, 0.5, 0.6, 260, 0.3, 1.7),
    Case("sphere", 7.5, 0.8, 1.0, 155, -2.4, -1.1),
    Case("flat", 2.8, 0.3, 0.3, 220, -0.9, 1.3),
    Case("square", 2.2, 0.3, 0.5, 15, 0.2, 0.4),
    Case("cylinder", 5.0, 0.5, 0.5, 90, 0.7, 0.1),
    Case("sphere", 6.0, 0.9, 0.6, 0, 0.4, -0.4, "press"),
    Case("sphere", 5.0, 0.6, 0.7, 60, -1.1, 0.6, "back"),
    Case("flat", 2.5, 0.35, 0.7, 330, 0.9, 0.8, "back"),
    Case("sphere", 6.0, 0.6, 0.8, 20, -0.7, -0.5, "rolls"),
)
QUICK = (JUDGED[0], JUDGED[1], JUDGED[2], JUDGED[11])


@dataclass(frozen=True)
class Run:
    """Truth of a case on the observed nodes, frame by frame.

    `touched` and `slipping` (t, n_y, n_x): part of each node's area; `share` (t,) of the contact that slips;
    `shear_n` (t,); `first_shear` the frame after which only the indenter's sideways way changes.
    """

    case: Case
    displacement: Array
    touched: Array
    slipping: Array
    share: Array
    shear_n: Array
    first_shear: int

    @property
    def gross(self) -> int | None:
        """The frame from which the contact slides."""
        slides = np.flatnonzero(self.share[self.first_shear :] > GROSS)
        return int(slides[0]) + self.first_shear if slides.size else None


def simulate(unit: TwinUnit, case: Case) -> Run:
    """Press, hold, and the case's way."""
    solver = ContactSolver(unit.model, unit.response(), Indenter(case.shape, case.radius * MM), case.friction)
    area = hat_areas(unit.model)
    grid, observed = unit.board.grid, unit.board.observed
    frames: list[tuple[Array, Array, float, float]] = []

    def advance(depth: float, way: float) -> float:
        """One frame; the true slipping share."""
        along, turn = way * MM, np.radians(case.heading)
        # Rolling without slip about the axis across the way; the pitch turns about y, so it rolls along x.
        rolls = case.way == "rolls"
        heading = 0.0 if rolls else turn
        pose = Pose(
            case.x * MM + along * np.cos(heading), case.y * MM + along * np.sin(heading), depth * MM,
            pitch_rad=along / (case.radius * MM) if rolls else 0.0,
        )  # fmt: skip
        solver.advance(pose)
        state = solver.contact_state
        parts = np.column_stack([area * (state > 0), area * (state == SLIPS), area])
        on_board = on_grid(unit.model, parts, grid.n_x, grid.n_y)[observed]
        share = float(parts[:, 1].sum() / max(parts[:, 0].sum(), 1e-30))
        shear = float(np.hypot(*solver.hat_force[:, :2].sum(axis=0)))
        nodes = on_board[..., :2] / on_board[..., 2:]
        frames.append((unit.at_nodes(solver.displacement)[observed], nodes, share, shear))
        return share

    for i in range(PRESS_FRAMES + HOLD_FRAMES):
        advance(case.depth * min(i + 1, PRESS_FRAMES) / PRESS_FRAMES, 0.0)
    first = len(frames)
    if case.way == "slides":
        way, left = 0.0, SLIDING_FRAMES
        while left and way < LONGEST_MM:
            way += STEP_MM
            left -= advance(case.depth, way) > GROSS
    else:
        reach = {"press": 0.0, "back": 0.06 * case.depth / 0.35, "rolls": 0.6}[case.way]
        n = max(int(reach / STEP_MM), 10)
        for way in [*np.linspace(0, reach, n), *np.linspace(reach, 0, n)]:
            advance(case.depth, float(way))
        for i in range(PRESS_FRAMES - 1):
            advance(case.depth * (PRESS_FRAMES - 1 - i) / PRESS_FRAMES, 0.0)
    u, nodes, share, shear = zip(*frames, strict=True)
    at = np.array(nodes)
    return Run(case, np.array(u), at[..., 0], at[..., 1], np.array(share), np.array(shear), first)


@dataclass(frozen=True)
class Watched:
    """What the board said, frame by frame: its largest contact (None: none), and the plane of stick and slip."""

    contact: list[ContactRow | None]
    nodes: npt.NDArray[np.uint8]

    def column(self, name: str) -> Array:
        """A field of the contact over the frames, 0 without one; thousandths as they are."""
        return np.array([float(getattr(c, name)) if c else 0.0 for c in self.contact])


def watch(pipeline: Pipeline, run: Run, disturbance: Disturbance, rng: np.random.Generator) -> Watched:
    """Run a case through the board's integers."""
    contacts: list[ContactRow | None] = []
    planes = []
    pipeline.solve(np.zeros((1, run.touched[0].size, 3), np.int16))  # untouched: the last run is forgotten
    for u in run.displacement:
        noisy = (u + disturbance.draw(u.shape, rng)) / DISPLACEMENT_LSB_M
        pipeline.solve(np.clip(np.round(noisy), -32767, 32767).astype(np.int16).reshape(1, -1, 3))
        found = pipeline.contacts()
        contacts.append(found[0] if found else None)
        planes.append(pipeline.raw("slip"))
    return Watched(contacts, np.array(planes))


@dataclass
class Scores:
    """Counts and lists over runs; see `report`."""

    n_sliding: int = 0
    n_detected: int = 0
    n_sticking_frames: int = 0
    n_false_frames: int = 0
    n_calm: int = 0
    n_calm_alarms: int = 0
    lead_frames: list[int] = field(default_factory=list)
    lead_load: list[float] = field(default_factory=list)
    slide_frames: list[int] = field(default_factory=list)
    friction_early: list[float] = field(default_factory=list)
    friction_late: list[float] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    share_error: list[float] = field(default_factory=list)
    nodes: Array = field(default_factory=lambda: np.zeros(4))  # slipping, found; sticking, called slipping

    def add(self, run: Run, seen: Watched) -> None:
        """Judge one run."""
        alarm = seen.column("slip_state") >= INCIPIENT
        sticks = run.share < STICKING
        self.n_sticking_frames += int(sticks.sum())
        self.n_false_frames += int((alarm & sticks).sum())
        gross = run.gross
        if gross is None:
            self.n_calm += 1
            self.n_calm_alarms += bool((alarm & sticks).any())
            return
        self._timing(run, seen, gross, alarm)
        self._friction(run, seen)
        after = np.arange(len(run.share)) >= run.first_shear
        told = after & (seen.column("slip_state") > 0)
        self.share_error += (1e-3 * seen.column("slip_share_1e3") - run.share)[told].tolist()
        slips = run.slipping > 0.5 * run.touched
        inside = (run.touched > 0.5) & (seen.nodes > 0) & after[:, None, None]
        found = seen.nodes == 2
        self.nodes += [(inside & slips).sum(), (inside & slips & found).sum(), (inside & ~slips).sum(),
                       (inside & ~slips & found).sum()]  # fmt: skip

    def _timing(self, run: Run, seen: Watched, gross: int, alarm: npt.NDArray[np.bool_]) -> None:
        self.n_sliding += 1
        first = np.flatnonzero(alarm & ~(run.share < STICKING))
        if first.size and first[0] < gross:
            self.n_detected += 1
            self.lead_frames.append(gross - int(first[0]))
            self.lead_load.append(float(run.shear_n[first[0]] / run.shear_n[gross]))
        slides = np.flatnonzero(seen.column("slip_state") == SLIDING)
        if slides.size:
            self.slide_frames.append(int(slides[0]) - gross)

    def _friction(self, run: Run, seen: Watched) -> None:
        friction, sigma = (1e-3 * seen.column(name) for name in ("friction_1e3", "friction_sigma_1e3"))
        error = friction / run.case.friction - 1
        known = friction > 0
        self.friction_early += error[known & (run.share <= GROSS)].tolist()
        self.friction_late += error[known & (run.share > GROSS)].tolist()
        self.covered += (np.abs(friction - run.case.friction) <= sigma)[known].tolist()

    def report(self, frame_ms: float) -> dict[str, Any]:
        """Everything in plain numbers; lead in milliseconds at one frame a step."""

        def rms(values: list[float]) -> float | None:
            return float(np.sqrt(np.mean(np.square(values)))) if values else None

        def mean(values: list[Any]) -> float | None:
            return float(np.mean(values)) if values else None

        return {
            "sliding_runs": self.n_sliding, "detected_before": self.n_detected,
            "calm_runs": self.n_calm, "calm_runs_with_alarm": self.n_calm_alarms,
            "sticking_frames": self.n_sticking_frames, "false_alarm_frames": self.n_false_frames,
            "lead_ms": {"mean": frame_ms * (mean(self.lead_frames) or 0.0),
                        "shortest": frame_ms * min(self.lead_frames, default=0)},
            "alarm_at_load": {"mean": mean(self.lead_load), "latest": max(self.lead_load, default=None)},
            "slides_after_ms": frame_ms * (mean(self.slide_frames) or 0.0), "slides_seen": len(self.slide_frames),
            "friction_error_before": {"mean": mean(self.friction_early), "rms": rms(self.friction_early)},
            "friction_error_sliding": {"mean": mean(self.friction_late), "rms": rms(self.friction_late)},
            "friction_within_sigma": mean(self.covered),
            "share_error": {"mean": mean(self.share_error), "rms": rms(self.share_error)},
            "slipping_nodes_found": float(self.nodes[1] / max(self.nodes[0], 1)),
            "sticking_nodes_called_slipping": float(self.nodes[3] / max(self.nodes[2], 1)),
        }  # fmt: skip


def default_calibration(board: Board) -> bytes:
    """The default operator's tables."""
    kind = make_operator(board, method="support", noise=Noise((5e-6, 5e-6, 20e-6)))
    return container.pack(kind.tensors, {**container.base_metadata(board), **kind.metadata}).data


def default_pipeline(board: Board) -> Pipeline:
    """The board's integers with the default operator."""
    return Pipeline(board, default_calibration(board))


def run(board: Board, *, quick: bool, progress: Progress = lambda _: None) -> dict[str, Any]:
    """The whole benchmark as one nested dict.

    Raises
    ------
    InputError
        The board has no twin, or an indenter does not fit its pad.
    """
    cases, n_seeds = (QUICK, 2) if quick else (JUDGED, 5)
    white = Disturbance(white_um=WHITE_UM)
    conditions: dict[str, tuple[PadError | None, Disturbance]] = {"noise 5/5/20 um": (None, white)}
    if not quick:
        conditions |= {
            "no noise": (None, Disturbance()),
            "correlated 5/5/20 um": (None, Disturbance(white_um=(2.5, 2.5, 10.0), correlated_um=WHITE_UM)),
            "pad 3 % off": (PAD_ERROR, white),
        }
    frame_ms = 1e6 / board.camera.rate_mhz
    result: dict[str, Any] = {
        "board": board.name, "simulated": True, "quick": quick, "cases": len(cases), "seeds": n_seeds,
        "speed_mm_s": STEP_MM / frame_ms * 1e3, "conditions": {},
    }  # fmt: skip
    twin = load_twin(board).with_pad(strain="linear", is_relaxing=False)
    runs: dict[PadError | None, list[Run]] = {}
    with default_pipeline(board) as pipeline:
        for k, (name, (error, disturbance)) in enumerate(conditions.items()):
            if error not in runs:
                unit = TwinUnit.build(board, error, twin=twin)
                runs[error] = [simulate(unit, case) for case in cases]
            scores = Scores()
            for i, one in enumerate(runs[error]):
                for seed in range(n_seeds):
                    scores.add(one, watch(pipeline, one, disturbance, np.random.default_rng((11, i, seed))))
                progress((k + (i + 1) / len(cases)) / len(conditions))
            result["conditions"][name] = scores.report(frame_ms)
    return result


def tables(result: dict[str, Any]) -> str:
    """The result as text."""
    lines = [
        f"{result['board']}, SIMULATED: {result['cases']} contacts, {result['seeds']} seeds, sheared at "
        f"{result['speed_mm_s']:.1f} mm/s; sliding: {100 * GROSS:.0f} % of the contact slips, "
        f"false alarm: less than {100 * STICKING:.0f} % does",
    ]
    for name, r in result["conditions"].items():
        load, share = r["alarm_at_load"], r["share_error"]
        lines += [
            "",
            name,
            f"  slip foreseen           {r['detected_before']} of {r['sliding_runs']} runs, "
            f"{r['lead_ms']['mean']:.0f} ms ahead (shortest {r['lead_ms']['shortest']:.0f}), "
            f"at {_percent(load['mean'])} of the load that slides (latest {_percent(load['latest'])})",
            f"  false alarms            {r['false_alarm_frames']} of {r['sticking_frames']} sticking frames; "
            f"{r['calm_runs_with_alarm']} of {r['calm_runs']} runs without slip",
            f"  sliding seen            {r['slides_seen']} of {r['sliding_runs']} runs, "
            f"{r['slides_after_ms']:+.0f} ms after it began",
            f"  friction, rim slips     {_error(r['friction_error_before'])}",
            f"  friction, all slides    {_error(r['friction_error_sliding'])}; "
            f"both within one sigma {_percent(r['friction_within_sigma'])}",
            f"  slipping share          off by {share['mean']:+.3f} on average, {share['rms']:.3f} rms",
            f"  nodes                   {_percent(r['slipping_nodes_found'])} of the slipping ones found, "
            f"{_percent(r['sticking_nodes_called_slipping'])} of the sticking ones called slipping",
        ]
    return "\n".join(lines)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"


def _error(error: dict[str, float | None]) -> str:
    mean, rms = error["mean"], error["rms"]
    return "-" if mean is None or rms is None else f"{100 * mean:+.1f} % on average, {100 * rms:.1f} % rms"
