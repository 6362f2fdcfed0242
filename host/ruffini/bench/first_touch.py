"""The first frame that says contact, and frames that say so though nothing touches. SIMULATED.

The twin's frames go through the board's own front end and solve, with [contact] threshold_un alone ("board") and with
the unit's noise as `cal fit --only threshold` measures it on untouched frames ("measured"): a ball and a flat punch
come down by STEP_UM a frame; frames from the first that truly touches to the first that reports it, the true force
then, and how far the reported force of faint touches is off. False contacts: in untouched rendered frames not fitted,
under lamps that drift while they are followed, and in fields drawn with the covariance of those frames' noise. A strong
press must stay one contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.light import SEED, WAY, Scene, fitted_calibration
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.core.pipeline import Pipeline
from ruffini.estimators.threshold.fit import ContactNoise, draw_largest, fit_contact_noise, linear_pressure
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.surface import wrench_of
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

N_FITTED, N_UNTOUCHED, N_DRAWN = 400, 400, 300_000
DRIFT, RAMPS = 0.02, {"fast drift": 300, "slow drift": 1_200}  # 2 % of a lamp in 5 and in 20 s
STEP_UM, LAST_UM = 2.0, 160.0
SHAPES = (("sphere", 4e-3, 4), ("flat", 2.5e-3, 2))  # kind, radius in m, approaches
FAINT_N = (5e-3, 40e-3)
STRONG_MM = (0.2, 0.4, 0.8)
WAYS = ("board", "measured")


class _Judged:
    """Both calibrations on the same frames."""

    def __init__(self, board: Board, scene: Scene, calibration: bytes, noise: ContactNoise) -> None:
        file = container.unpack(calibration)
        with_noise = container.pack({**file.tensors, **noise.tensors()}, file.metadata).data
        self.scene = scene
        self.pipelines = {"board": Pipeline(board, calibration), "measured": Pipeline(board, with_noise)}

    def close(self) -> None:
        for pipeline in self.pipelines.values():
            pipeline.close()

    def learn(self) -> None:
        """Learn rest again."""
        for pipeline in self.pipelines.values():
            pipeline.zero()
            self.scene.learn(pipeline)

    def see(self, frame: npt.NDArray[np.uint8]) -> dict[str, tuple[int, float]]:
        """Contacts and normal force, N, that each reports."""
        results = {way: pipeline.process(frame) for way, pipeline in self.pipelines.items()}
        return {way: (r.n_contacts, -float(r.wrench[2])) for way, r in results.items()}


def _false(judged: _Judged, frames: Iterable[npt.NDArray[np.uint8]]) -> dict[str, int]:
    judged.learn()
    seen = [judged.see(frame) for frame in frames]
    return {way: sum(s[way][0] > 0 for s in seen) for way in WAYS}


def _approach(judged: _Judged, kind: str, radius_m: float) -> dict[str, Any]:
    """One approach: per way frames late and force at the first report; errors of faint forces."""
    scene = judged.scene
    judged.learn()
    x, y = scene.rng.uniform(-3e-3, 3e-3, 2)
    solver = scene.unit.solver(Indenter(kind, radius_m))
    first: dict[str, tuple[int, float]] = {}
    errors: dict[str, list[float]] = {way: [] for way in WAYS}
    touched_at = 0
    for step in range(1, round(LAST_UM / STEP_UM) + 1):
        solver.advance(Pose(float(x), float(y), step * STEP_UM * 1e-6))
        force_n = -float(wrench_of(scene.unit.model, solver.nodal_force)[2])
        touched_at = touched_at or (step if force_n > 0 else 0)
        for way, (n_contacts, said_n) in judged.see(scene.frame(solver.displacement)).items():
            if n_contacts > 0 and way not in first:
                first[way] = (step - touched_at, force_n)
            if FAINT_N[0] <= force_n <= FAINT_N[1]:
                errors[way].append(said_n - force_n)
    return {"first": first, "errors": errors}


def _touches(judged: _Judged, progress: Progress) -> list[dict[str, Any]]:
    rows = []
    for i, (kind, radius_m, n) in enumerate(SHAPES):
        done = [_approach(judged, kind, radius_m) for _ in range(n)]
        for way in WAYS:
            first = [d["first"][way] for d in done if way in d["first"]]
            errors = np.concatenate([d["errors"][way] for d in done])
            rows.append({
                "shape": kind, "way": way, "approaches": n, "frames_late": [f for f, _ in first],
                "force_n": [f for _, f in first],
                "faint_rms_n": float(np.sqrt((errors**2).mean())) if len(errors) else None,
            })  # fmt: skip
        progress((i + 1) / len(SHAPES))
    return rows


def _strong(judged: _Judged) -> dict[str, int]:
    """The most contacts that a single press is reported as."""
    judged.learn()
    most = dict.fromkeys(WAYS, 0)
    for kind, radius_m, _ in SHAPES:
        solver = judged.scene.unit.solver(Indenter(kind, radius_m))
        for depth_mm in STRONG_MM:
            solver.advance(Pose(1e-3, -1e-3, depth_mm * 1e-3))
            seen = judged.see(judged.scene.frame(solver.displacement))
            most = {way: max(most[way], seen[way][0]) for way in WAYS}
    return most


def run(board: Board, *, progress: Progress = lambda _: None) -> dict[str, Any]:
    """All of it.

    Raises
    ------
    InputError
        The board has no twin, or its displacement does not come from dots and colours.
    """
    scene = Scene(board)
    calibration = fitted_calibration(board)
    file = container.unpack(calibration)
    progress(0.2)
    n_rest = board.pipeline.n_rest_frames
    noise = fit_contact_noise(linear_pressure(board, file, (scene.frame() for _ in range(N_FITTED + n_rest))), n_rest)
    other = linear_pressure(board, file, (scene.frame() for _ in range(N_UNTOUCHED + n_rest)))
    deviation = (other - other.mean(axis=0)) * np.sqrt((1 + 1 / n_rest) / (len(other) - 1))
    progress(0.3)
    squares, nodes = draw_largest(deviation, N_DRAWN, SEED)
    progress(0.4)
    judged = _Judged(board, scene, calibration, noise)
    try:
        untouched = _false(judged, (scene.frame() for _ in range(N_UNTOUCHED)))
        ramps = {
            name: [n, _false(judged, (scene.frame(gain=1 + DRIFT * WAY * i / n) for i in range(n)))]
            for name, n in RAMPS.items()
        }
        progress(0.5)
        touches = _touches(judged, lambda done: progress(0.5 + 0.45 * done))
        strong = _strong(judged)
    finally:
        judged.close()
    threshold_n = board.contact.threshold_un * 1e-6
    drawn = {
        "board": int((squares > threshold_n).sum()),
        "measured": int(((squares > noise.square_n) | (nodes > noise.alone_n)).sum()),
    }
    false = {"untouched": [N_UNTOUCHED, untouched], **ramps, "drawn": [N_DRAWN, drawn]}
    return {"board": board.name, "simulated": True, "noise": noise.report(), "false": false, "touches": touches,
            "strong": strong}  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    noise, false, strong = result["noise"], result["false"], result["strong"]
    lines = [
        f"{result['board']}, SIMULATED: noise of a node {noise['node_sigma_mn']:.3f} mN; touched from "
        f"{noise['square_mn']:.3f} mN on 2 x 2 nodes, {noise['alone_mn']:.3f} mN on one",
    ]
    names = {
        "untouched": "frames rendered",
        **{name: f"frames, lamps drift by {100 * DRIFT:g} %" for name in RAMPS},
        "drawn": "fields drawn",
    }
    lines += aligned(("false contacts", *WAYS), [
        (f"{false[key][0]:,} {name}", *(false[key][1][way] for way in WAYS)) for key, name in names.items()
    ])  # fmt: skip
    lines.append(f"first touch, {STEP_UM:g} um a frame")
    for row in result["touches"]:
        late, force_mn = row["frames_late"], [1e3 * f for f in row["force_n"]]
        found = f"{len(late)} of {row['approaches']} found"
        if late:
            found = (
                f"{min(late)} to {max(late)} frames late, at {min(force_mn):.1f} to {max(force_mn):.1f} mN, " + found
            )
        if row["faint_rms_n"] is not None:
            found += (
                f"; forces of {1e3 * FAINT_N[0]:g} to {1e3 * FAINT_N[1]:g} mN off by {1e3 * row['faint_rms_n']:.1f} mN"
            )
        lines.append(f"  {row['shape']:8}{row['way']:10}{found}")
    lines.append(
        "a single strong press is at most " + ", ".join(f"{strong[way]} ({way})" for way in WAYS) + " contacts"
    )
    return "\n".join(lines)
