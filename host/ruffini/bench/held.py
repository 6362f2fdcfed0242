"""A pad that relaxes: `ruffini cal fit --only relaxation` on some held touches, judged on others. SIMULATED.

Everything as on a real sensor: the twin's gel relaxes (a Prony series), its frames go through the real front end, the
fit sees them and a load cell's wrench, and what it finds goes into the calibration that the board then computes with.
The board runs at a low frame rate here: relaxation goes by time, not by frames.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.bench.fitted import NOISE, colours_of
from ruffini.boards import Board, parse_board
from ruffini.calibrate import container
from ruffini.core.pipeline import Pipeline
from ruffini.estimators.operator.fit import Material, board_slab, make_operator
from ruffini.estimators.relaxation.fit import RelaxationFit, fit_relaxation, log_from_recording
from ruffini.frames import read_frames
from ruffini.sim.contact import Indenter, Pose
from ruffini.sim.programs import Rest, Step, Touch
from ruffini.sim.recording import record_touches
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit
from ruffini.tables import aligned

Array = npt.NDArray[np.float64]
Progress = Callable[[float], None]

RATE_HZ = 10
RAMP_FRAMES, REST_FRAMES = 4, 15
SEED = 20_261_123
MM = 1e-3


@dataclass(frozen=True)
class Held:
    """One touch: lengths in mm; pressed, moved sideways by `shift` on the way down, and held."""

    shape: str
    radius: float
    x: float
    y: float
    depth: float
    shift: float
    seconds: float


LOGGED = (
    Held("sphere", 6, 0.5, 0.4, 0.8, 0.0, 8.0),
    Held("flat", 2.2, -2.0, 1.0, 0.5, 0.0, 5.0),
    Held("sphere", 5, 2.4, -1.6, 0.6, 0.2, 6.0),
)
JUDGED = (
    Held("sphere", 7, -1.6, -1.2, 0.7, 0.15, 10.0),
    Held("flat", 2.5, 1.8, 1.2, 0.6, 0.0, 7.0),
    Held("square", 1.8, -1.0, 0.8, 0.5, 0.1, 4.0),
)


def slowed(board: Board, rate_hz: int = RATE_HZ) -> Board:
    """The board with another frame rate."""
    text = re.sub(r"(?m)^rate_mhz\s*=\s*\d+", f"rate_mhz = {1000 * rate_hz}", board.text)
    return parse_board(text, f"{board.name} at {rate_hz} Hz")


def story(touches: tuple[Held, ...]) -> list[Step]:
    """Rest, then each touch: down, held (judged), away."""
    steps: list[Step] = [Rest(REST_FRAMES)]
    for t in touches:
        start, end = Pose(t.x * MM, t.y * MM, 0.0), Pose((t.x + t.shift) * MM, t.y * MM, t.depth * MM)
        ramp = [start.towards(end, (i + 1) / RAMP_FRAMES) for i in range(RAMP_FRAMES)]
        hold = round(t.seconds * RATE_HZ)
        touch = Touch(Indenter(t.shape, t.radius * MM), ramp + hold * [end], RAMP_FRAMES * [False] + hold * [True])
        steps += [touch, Rest(REST_FRAMES)]
    return steps


def run(board: Board, *, progress: Progress = lambda _: None) -> dict[str, Any]:
    """Record, fit, judge.

    Raises
    ------
    InputError
        The board's gel does not relax, or its displacement does not come from dots and colours.
    """
    slow = slowed(board)
    twin = load_twin(board).with_pad(strain="linear", is_relaxing=True)
    unit = TwinUnit.build(slow, twin=twin)
    colours = colours_of(board)
    progress(0.1)
    with tempfile.TemporaryDirectory() as folder:
        logged, judged = Path(folder) / "logged", Path(folder) / "judged"
        record_touches(
            unit, story(LOGGED), logged, seed=SEED, program="held", progress=lambda d: progress(0.1 + 0.4 * d)
        )
        record_touches(
            unit, story(JUDGED), judged, seed=SEED + 1, program="held", progress=lambda d: progress(0.5 + 0.4 * d)
        )
        before = _calibration(slow, colours, None)
        fit = fit_relaxation(log_from_recording(slow, before, logged, None, progress=lambda _: None))
        after = _calibration(slow, colours, fit)
        rows = {"elastic": _errors(slow, before, judged), "relaxation": _errors(slow, after, judged)}
    progress(1.0)
    return {"board": board.name, "simulated": True, "rate_hz": RATE_HZ, "fit": fit.report(),
            "true_loss": twin.pad.prony().loss, "rows": rows}  # fmt: skip


def _calibration(board: Board, colours: dict[str, Any], fit: RelaxationFit | None) -> container.CalibrationFile:
    """As `cal fit --only operator`, without or with `--relaxation`."""
    slab = board_slab(board)
    gain, (tensors, metadata) = (1.0, ({}, {})) if fit is None else (fit.gain, fit.tensors())
    kind = make_operator(
        board, method="support", noise=NOISE,
        material=Material(slab.modulus_pa * gain, slab.poisson, slab.thickness_m),
    )  # fmt: skip
    return container.pack(
        {**kind.tensors, **colours, **tensors}, {**container.base_metadata(board), **kind.metadata, **metadata}
    )


def _errors(board: Board, calibration: container.CalibrationFile, recording: Path) -> list[dict[str, float]]:
    """Of each judged touch: error of the held force, percent of the true one, at its start, its end and rms."""
    truth = np.load(recording / "truth.npz")
    relative: dict[int, list[float]] = {}
    with Pipeline(board, calibration.data) as pipeline:
        for i, image in enumerate(read_frames(recording)):
            frame = pipeline.process(image)
            if truth["judged"][i]:
                true = truth["wrench"][i][:3]
                along = float((frame.wrench[:3] - true) @ true / (true @ true))
                relative.setdefault(int(truth["touch"][i]), []).append(100 * along)
    return [
        {"seconds": len(e) / RATE_HZ, "start": e[0], "end": e[-1], "rms": float(np.sqrt(np.mean(np.square(e))))}
        for e in relative.values()
    ]


def table(result: dict[str, Any]) -> str:
    """The rows as text."""
    fit = result["fit"]
    terms = ", ".join(f"{100 * t['part']:.1f} % in {t['time_s']:g} s" for t in fit["terms"])
    lines = [
        f"{result['board']}, SIMULATED: a gel that loses {100 * result['true_loss']:.0f} % of its first force; "
        f"`cal fit --only relaxation` on {len(LOGGED)} held touches finds {terms}",
        *aligned(("held force, error", "held", "at first", "at the end", "rms"), [
            (name, f"{t['seconds']:.0f} s", f"{t['start']:+.1f} %", f"{t['end']:+.1f} %", f"{t['rms']:.1f} %")
            for name, touches in result["rows"].items() for t in touches
        ]),
    ]  # fmt: skip
    return "\n".join(lines)
