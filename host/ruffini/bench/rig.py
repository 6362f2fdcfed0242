"""The simulated calibration bench of a board: how long it takes, and how well it finds its two clocks. SIMULATED.

Everything of `ruffini cal collect --rig sim`: the real daemon on a real serial line, the twin as its camera, an
emulated machine on a pty, an emulated reference in its real protocol. The reference is also held back by known times;
for each frame it is known when the camera had it and when the reference spoke, so the clock offset that the log finds
can be judged.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ruffini.bench.fitted import NOISE
from ruffini.boards import Board
from ruffini.calibrate import container
from ruffini.calibrate.auto.truth import Truth
from ruffini.demo.twin_session import TwinOptions, limits_of, open_simulated, reach_of
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.rig.collect import collect
from ruffini.rig.log_file import LogWriter, read_log
from ruffini.rig.program import plan, span_of
from ruffini.rig.session import ready_bench
from ruffini.sim.recording import record_balls
from ruffini.sim.unit import TwinUnit

Progress = Callable[[float], None]

DELAYS_S = (0.0, 0.020, 0.055)  # of the reference
N_TOUCHES, N_QUICK = 20, 4
DEPTH_M, SHEAR_M = 0.8e-3, 0.5e-3
N_BALLS, BALL_MM, SEED = 24, 5.0, 20_261_121


def run(
    board: Board, *, n: int | None = None, quick: bool = False, machine: str = "marlin",
    calibration: bytes | None = None, progress: Progress = lambda _: None,
) -> dict[str, Any]:  # fmt: skip
    """Collect on the simulated bench, with each delay of the reference where the sensor measures force.

    Raises
    ------
    InputError
        The board has no twin.
    """
    has_forces = board.writes("node_forces")
    if has_forces and calibration is None:
        calibration = _calibration(board)
    count = n or (N_QUICK if quick else N_TOUCHES)
    delays = DELAYS_S if has_forces else DELAYS_S[:1]
    rows = []
    for i, delay_s in enumerate(delays):
        rows.append(_collected(board, count, machine, calibration, delay_s))
        progress((i + 1) / len(delays))
    return {"board": board.name, "simulated": True, "machine": machine, "rows": rows}


def _collected(board: Board, n: int, machine: str, calibration: bytes | None, delay_s: float) -> dict[str, Any]:
    span = span_of(board, DEPTH_M, SHEAR_M, reach_of(board))
    items, limits = plan("grid", span, n, SEED), limits_of(board, span, 6.0)
    truth, begun = Truth(delay_s), time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder, contextlib.ExitStack() as stack:
        simulated = open_simulated(stack, board, "grid", TwinOptions(machine, seed=SEED))
        simulated.twin.cell.delay_s = delay_s
        simulated.twin.twin.listeners.append(truth.note)
        if calibration is not None:
            simulated.parts.sensor.flash(calibration)
        bench = stack.enter_context(ready_bench(simulated.parts, board, limits))
        ready = time.monotonic()
        out = Path(folder) / "log.h5"
        n_redone = collect(bench, items, LogWriter(out, {"board": board.name}))
        done = time.monotonic()
        log = read_log(out)
    (clock,) = log.found["clocks"]
    true_s = truth.offset_s(log)
    found = {
        "offset_error_ms": 1e3 * (clock["offset_s"] - true_s), "offset_sigma_ms": 1e3 * clock["sigma_s"]
    } if "offset_s" in clock else {"why_not": clock["why_not"]}  # fmt: skip
    frames = np.concatenate([t.arrays["stream_host_s"] for t in log.touches])
    return {
        "touches": n, "redone": n_redone, "ready_s": ready - begun, "seconds": done - ready,
        "frames_per_s": len(frames) / sum(float(np.ptp(t.arrays["stream_host_s"])) for t in log.touches),
        "delay_ms": 1e3 * delay_s, "true_offset_ms": 1e3 * true_s, **found,
    }  # fmt: skip


def _calibration(board: Board) -> bytes:
    """Colours from the twin's ball presses, and the board's own material."""
    camera = board.camera
    pinhole = Pinhole(
        camera.focal_mpx / 1e3, camera.center_x_mpx / 1e3, camera.center_y_mpx / 1e3, camera.standoff_um / 1e3
    )
    with tempfile.TemporaryDirectory(prefix="ruffini-") as folder:
        record_balls(TwinUnit.build(board), N_BALLS, Path(folder) / "balls", ball_mm=BALL_MM, seed=SEED)
        fit = fit_photometric(collect_samples(load_presses(Path(folder) / "balls"), pinhole))
    kind = make_operator(board, method="support", noise=NOISE, n_touches=0)
    tensors = {**kind.tensors, **tabulate(fit.model)}
    return container.pack(tensors, {**container.base_metadata(board), **kind.metadata}).data


def table(result: dict[str, Any]) -> str:
    """Text of a result."""
    lines = [f"{result['board']}, SIMULATED, {result['machine']}: daemon, serial line, machine and reference as in use"]
    for r in result["rows"]:
        lines.append(
            f"  {r['touches']} presses in {r['seconds']:.0f} s ({r['seconds'] / r['touches']:.1f} s each, "
            f"{r['redone']} done again, {r['frames_per_s']:.0f} frames/s), ready after {r['ready_s']:.0f} s"
        )
        clock = (
            f"off by {r['offset_error_ms']:+.2f} ms, said +-{r['offset_sigma_ms']:.2f} ms"
            if "offset_error_ms" in r
            else f"not found: {r['why_not']}"
        )
        lines.append(f"  reference {r['delay_ms']:.0f} ms late, true offset {r['true_offset_ms']:.1f} ms: {clock}")
    return "\n".join(lines)
