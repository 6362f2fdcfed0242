"""Single faults of camera, light and pad: how soon each is flagged, what wrong force passes as valid. SIMULATED.

The twin's frames go through the board's own pipeline, as a live camera's, untouched and under a ball; then come N_BAD
frames with a fault, then good ones again. A force is wrong where a component that the frame calls VALID is off the
truth by more than five of its standard deviations and by more than 5 % of the full scale. A fault that is not
flagged within three frames must leave every force right.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.picture_faults import CONDITIONS, PICTURES, Picture, bad_pictures
from ruffini.core import Pipeline
from ruffini.core.pipeline import Frame
from ruffini.errors import InputError
from ruffini.sim.indenters import Indenter
from ruffini.sim.optics.conditions import Conditions
from ruffini.sim.pose import Pose
from ruffini.sim.rig import Unit
from ruffini.tables import aligned
from ruffini.wire.covariance import full_covariance

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

SEED = 20_261_122
N_BAD, MOST_FRAMES = 6, 3
N_GOOD, N_BACK = 12, 60  # frames before a fault; until which the frames are good again
BALL_M, STEPS = 4e-3, 4
PLACE_M = {"tube": (-36e-3, 5e-3, 2.4e-3)}  # elsewhere near the middle
MIDDLE_M = (1e-3, -1e-3, 0.6e-3)
UNCALIBRATED, VALID = 2 | 4, 1
FAULTS = (*CONDITIONS, *PICTURES)
N_SIGMA, FULL_SCALE_SHARE = 5, 0.05


class Scene:
    """A unit's good pictures, untouched and pressed, and the true wrench (N, N m) of both."""

    def __init__(self, unit: Unit) -> None:
        self._rng = np.random.default_rng(SEED)
        self._renderer = unit.renderer()
        rig = unit.rig()
        self._states = {"untouched": (rig.displacement.copy(), rig.tray)}
        rig.take(Indenter("sphere", BALL_M))
        x, y, depth = PLACE_M.get(unit.twin.shape.kind, MIDDLE_M)
        for step in range(STEPS):
            rig.advance(Pose(x, y, depth * (step + 1) / STEPS))
        self._states["pressed"] = (rig.displacement.copy(), rig.tray)
        self.truth = {"untouched": np.zeros(6), "pressed": np.asarray(rig.wrench())}

    def picture(self, state: str, conditions: Conditions | None = None) -> Picture:
        """A frame with the camera's noise."""
        displacement, tray = self._states[state]
        return self._renderer.image(displacement, self._rng, conditions=conditions, tray=tray)


def wrong_by(pipeline: Pipeline, frame: Frame, truth: Array, full_scale_n: float) -> float:
    """Largest error of a force component that passes as valid and is wrong, newtons; 0: none does."""
    try:
        sigma = np.sqrt(np.diag(full_covariance(pipeline.covariance())))[:3]
    except InputError:
        sigma = np.zeros(3)
    error = np.abs(frame.wrench[:3] - truth[:3])
    is_valid = np.array(frame.wrench_validity[:3]) == VALID
    is_wrong = is_valid & (error > N_SIGMA * sigma) & (error > FULL_SCALE_SHARE * full_scale_n)
    return float((error * is_wrong).max())


def run(
    unit: Unit,
    calibration: bytes | None,
    *,
    full_scale_n: float,
    names: tuple[str, ...] = FAULTS,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Each fault on the untouched and on the pressed pad.

    Raises
    ------
    InputError
        The calibration is another board's.
    """
    board, scene = unit.board, Scene(unit)
    rows: list[dict[str, Any]] = []
    with Pipeline(board, calibration) as pipeline:
        pipeline.set_live()

        def show(picture: Picture) -> Frame:
            return pipeline.process(picture)

        for _ in range(board.pipeline.n_rest_frames + N_GOOD):
            show(scene.picture("untouched"))
        for state, truth in scene.truth.items():
            for name in ("none", *names):
                rows.append({"fault": name, "state": state}
                            | _one_fault(pipeline, scene, state, name, truth, full_scale_n))  # fmt: skip
                progress(len(rows) / (2 * len(names) + 2))
    return {
        "board": board.name, "simulated": True, "seed": SEED, "is_calibrated": calibration is not None,
        "full_scale_n": full_scale_n, "truth_n": scene.truth["pressed"][:3].tolist(), "rows": rows,
        "n_silent": sum(not row["is_safe"] for row in rows),
    }  # fmt: skip


def _one_fault(
    pipeline: Pipeline, scene: Scene, state: str, name: str, truth: Array, full_scale_n: float
) -> dict[str, Any]:
    for _ in range(N_BACK):
        if not pipeline.process(scene.picture(state)).flags & ~UNCALIBRATED:
            break
    for _ in range(N_GOOD):
        usual = pipeline.process(scene.picture(state)).flags & ~UNCALIBRATED
    if name == "none":
        pictures = [scene.picture(state) for _ in range(N_BAD)]
    else:
        pictures = bad_pictures(name, lambda c: scene.picture(state, c), SEED, N_BAD)
    if name == "frozen":
        usual |= pipeline.process(pictures.pop(0)).flags & ~UNCALIBRATED
    first, flags, error_n = 0, 0, 0.0
    for i, picture in enumerate(pictures, start=1):
        frame = pipeline.process(picture)
        flags |= frame.flags & ~UNCALIBRATED
        if not first and frame.flags & ~UNCALIBRATED & ~usual:
            first = i
        error_n = max(error_n, wrong_by(pipeline, frame, truth, full_scale_n))
    good_after = next((i for i in range(1, N_BACK + 1) if pipeline.process(scene.picture(state)).flags & ~UNCALIBRATED
                       == usual), 0)  # fmt: skip
    is_flagged = 0 < first <= MOST_FRAMES
    # Flagged in time, or harmless; and never a wrong force that passes as valid.
    is_safe = error_n == 0 and (name != "none" or not flags)
    return {"flagged_in_frame": first, "is_flagged": is_flagged, "flags": flags, "unmarked_error_n": error_n,
            "good_after_frames": good_after, "is_safe": is_safe}  # fmt: skip


def table(result: dict[str, Any]) -> str:
    """The result as text."""
    x, y, z = result["truth_n"]
    kind = "calibrated" if result["is_calibrated"] else "no calibration: flags only"
    lines = [
        f"{result['board']}, SIMULATED, {kind}; seed {result['seed']}, full scale {result['full_scale_n']:g} N, "
        f"pressed with {x:.2f}, {y:.2f}, {z:.2f} N",
        *aligned(("fault", "pad", "flagged in frame", "wrong, unmarked", "good again after", "flags"), [
            (
                row["fault"], row["state"], row["flagged_in_frame"] or "-",
                f"{row['unmarked_error_n']:.3f} N" if row["unmarked_error_n"] else "0",
                row["good_after_frames"] or f"> {N_BACK}", row["flags"],
            )
            for row in result["rows"]
        ]),
    ]  # fmt: skip
    lines.append(f"faults that let a wrong force pass unmarked: {result['n_silent']} of {len(result['rows'])}")
    return "\n".join(lines)
