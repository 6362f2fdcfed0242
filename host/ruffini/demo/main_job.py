"""What `make run` does: recording -> calibration -> ruffinid -> flash over the line -> stream -> pictures.

Everything goes through the real daemon and a real serial line; nothing is taken from the twin but the
frames and, for judging, the truth.
"""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.cli.common import note, progress_bar
from ruffini.daemon import running_daemon
from ruffini.demo.calibration import NOISE_WITHOUT_DEPTH, calibrated, has_field, kept_calibration
from ruffini.demo.live import LiveField
from ruffini.demo.pictures import AXES, depth_map, field_over_frame, wrench_over_time
from ruffini.demo.twin_pictures import pictures_of_twin
from ruffini.demo.view import depth_places, node_pixels, node_places
from ruffini.device import Connection
from ruffini.device.results import RESULTS, UNCALIBRATED, VALID, Markers
from ruffini.errors import InputError, NoDeviceError, RuffiniError
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.skin.presses import out_of
from ruffini.frames import read_frames
from ruffini.sim.unit import PadError
from ruffini.wire import Schema

Array = npt.NDArray[np.float64]

# The unit that is simulated is not the board's nominal one: 3 % off in each material number.
DEMO_ERROR = {"modulus": 1.03, "poisson": 1.03, "thickness": 0.97}
MAX_ERROR, MAX_ERROR_OF_A_LOOK = 0.05, 0.25  # of the largest true force; of few presses, or without a depth
MAX_REST_PX = 0.15
MIN_COSINE = 0.95
CONTACT_START_PX = 0.2  # mean dot motion that tells that touching has begun
GUARD_FRAMES = 4  # before that: the touch may show in single dots first


class CheckFailed(RuffiniError):
    """A figure of the main job is not met (exit code 1)."""

    exit_code = 1


@dataclass(frozen=True)
class RealInput:
    """A real recording and, optionally, ball presses from some optics."""

    video: Path
    presses: Path | None
    ball_mm: float
    px_per_mm: float


@dataclass
class Run:
    """What came over the line, by frame number."""

    results: dict[str, dict[int, Any]] = field(default_factory=lambda: {k: {} for k in (*RESULTS, "MARKERS")})
    status: Any = None
    is_simulated: bool = False

    def frames(self) -> list[int]:
        return sorted(self.results["WRENCH"])

    def wrench(self) -> Array:
        return np.array([self.results["WRENCH"][i].values for i in self.frames()])


@contextmanager
def _step(title: str) -> Iterator[None]:
    start = time.monotonic()
    yield
    note(f"{title}: {time.monotonic() - start:.1f} s")


def _stream(board: Board, recording: Path, out: Path, calibration: bytes, truth: Array | None, *options: str) -> Run:
    """Play a recording through ruffinid, flash the calibration, and collect the stream."""

    run = Run()
    store = out / "store"
    awaited = ("WRENCH", "FIELD") if has_field(board) else ("WRENCH",)  # of a frame, before it is shown
    assert board.folder is not None
    with (
        running_daemon(board.folder, f"replay:{recording}", store, "--wait-for-host", *options) as port,
        Connection(port) as sensor,
    ):
        with progress_bar("flash") as progress:
            sensor.flash(calibration, progress)
        note(f"flashed {len(calibration) / 1e6:.1f} MB over {port}, in force")
        with LiveField(f"{board.name} on {port}") as live:
            stale = sensor.schema.enum_number("FlagBit", "FLAG_STALE")
            sensor.subscribe(wrench=1, field=1, depth=10, contacts=1, markers=1, status=1)
            try:
                for frame, message in sensor.stream(timeout_s=3.0):
                    name = sensor.schema.type_name(frame.type)
                    run.is_simulated |= frame.is_simulated
                    if name == "STATUS":
                        run.status = message
                    elif name == "MARKERS":
                        markers = Markers.from_message(message)
                        run.results[name][markers.frame] = markers.displacement_px
                    elif name in RESULTS:
                        result = RESULTS[name].from_message(message)
                        if result.flags & stale:  # a busy machine's stall: the last wrench again, marked
                            continue
                        run.results[name][result.frame] = result
                        if name in awaited and all(result.frame in run.results[of] for of in awaited):
                            _show(live, run, result.frame, truth, sensor)
            except NoDeviceError:
                pass  # the recording ended and the daemon with it
    if not run.results["WRENCH"]:
        raise RuffiniError("no frame came over the line")
    return run


def _show(live: LiveField, run: Run, frame: int, truth: Array | None, sensor: Connection) -> None:
    wrench, field = run.results["WRENCH"][frame], run.results["FIELD"].get(frame)
    true = truth[frame] if truth is not None else None
    flags = sensor.schema.enum_names("FlagBit", wrench.flags)
    live.show(None if field is None else field.raw_force, wrench.values, true, flags)


def check_sums(run: Run) -> int:
    """Largest difference between a wrench's force and its field's sum, in micronewton: must be 0.

    Raises
    ------
    CheckFailed
        A field is not valid along an axis along which its wrench is, or there is nothing to compare.
    """
    differences = list[int]()
    for i, wrench in run.results["WRENCH"].items():
        seen = np.array(wrench.validity[:3]) == VALID
        got = run.results["FIELD"].get(i)
        if got is None or not seen.any():
            continue
        if not np.isfinite(got.force[..., seen]).all():
            raise CheckFailed(f"frame {i}: the wrench is valid along an axis along which its field is not")
        total = got.force_steps.astype(np.int64).sum(axis=(0, 1)) * round(got.force_lsb_n * 1e6)
        differences.append(int(np.abs(total[seen] - np.round(wrench.values[:3][seen] * 1e6)).max()))
    if not differences:
        raise CheckFailed("no frame came with both a valid wrench and its field: their sums cannot be compared")
    return max(differences)


def run_twin(board_name: str, out: Path, *, as_json: bool) -> None:
    """The main job on the digital twin."""
    from ruffini.sim.bodies import touches
    from ruffini.sim.recording import record_touches
    from ruffini.sim.units import build_unit

    board = find_board(board_name)
    shutil.rmtree(out, ignore_errors=True)
    # Where forces follow from board.toml's numbers, the unit is another one; elsewhere the unit itself is pressed.
    error = PadError(**DEMO_ERROR) if has_field(board) else None
    with _step("twin: pad mechanics"), progress_bar("pad mechanics") as progress:
        unit = build_unit(board, error, progress=progress)
    with _step("twin: the recording"), progress_bar("recording") as progress:
        story = touches.demo(board, unit.twin)
        record_touches(unit, story, out / "recording", seed=12, program="demo", progress=progress)
    with _step("calibrate"):
        file, photometric = calibrated(board, unit, out) if error else (kept_calibration(board, unit), {})
    container.write(out / "calibration.safetensors", file)
    truth = dict(np.load(out / "recording" / "truth.npz"))
    truth["wrench"] = _true_wrench(board, truth)
    run = _stream(board, out / "recording", out, file.data, truth["wrench"])
    _report_twin(board, out, run, truth, photometric, as_json)


def _true_wrench(board: Board, truth: dict[str, Any]) -> Array:
    """What the board calls its wrench, (t, 6): of a tube its force along z is the sum of what presses inwards."""
    wrench = np.asarray(truth["wrench"], float)
    if board.skin is None or board.skin.shape != "tube":
        return wrench
    x_mm = np.linspace(-0.5, 0.5, board.grid.n_x) * board.pad.size_x_um * 1e-3
    out = np.array([out_of(board.skin, np.array([x, 0.0])) for x in x_mm])
    return np.column_stack([wrench[:, :2], np.einsum("tyxc,xc->t", truth["force"], out), wrench[:, 3:]])


def _report_twin(
    board: Board, out: Path, run: Run, truth: dict[str, Any], photometric: dict[str, Any], as_json: bool
) -> None:
    stated = {i: np.array(run.results["WRENCH"][i].validity) for i in run.frames()}
    frames = [i for i in run.frames() if (stated[i][:3] == VALID).any()]
    if not frames:
        raise CheckFailed(f"{board.name}: none of {len(run.frames())} frames has a valid force")
    measured = np.array([np.where(stated[i] == VALID, run.results["WRENCH"][i].values, np.nan) for i in frames])
    true = truth["wrench"][frames]
    axes = [AXES[k] for k in range(3) if np.isfinite(measured[:, k]).any()]
    seen = np.where(np.isfinite(measured[:, :3]), true[:, :3], 0.0)
    error = np.linalg.norm(np.nan_to_num(measured[:, :3]) - seen, axis=1)
    largest = float(np.linalg.norm(seen, axis=1).max())
    badge = f"{board.name}, SIMULATED"
    pictures = pictures_of_twin(board, out, run.results, truth, badge)
    per_mm = np.array([1, 1, 1, 1e3, 1e3, 1e3])
    pictures.append(wrench_over_time(out / "wrench.png", truth["time_s"][frames], measured * per_mm,
                                     title=f"{badge}: wrench over the line", truth=true * per_mm))  # fmt: skip
    sums = check_sums(run) if has_field(board) else 0
    error_p95, limit = float(np.percentile(error, 95)), MAX_ERROR if photometric else MAX_ERROR_OF_A_LOOK
    result = {
        "board": board.name, "simulated": True, "frames": len(run.frames()), "valid_frames": len(frames),
        "force_axes": axes, "resultant_error_mean_n": float(error.mean()), "resultant_error_p95_n": error_p95,
        "largest_true_force_n": largest, "sum_difference_un": sums,
        "normals_held_out_deg": photometric.get("held_out_normal_median_deg"), "pictures": [str(p) for p in pictures],
        "twin_off_by": DEMO_ERROR if has_field(board) else None,
    }  # fmt: skip
    if as_json:
        print(json.dumps(result))
    else:
        print(f"{badge}; " + (
            "the twin's E, nu and thickness are 3 % off what the calibration believes" if has_field(board)
            else "calibrated on the few presses of its demo.toml"
        ))  # fmt: skip
        sum_text = f"; field sums to the wrench within {sums} uN" if has_field(board) else ""
        print(f"  {len(frames)} valid of {len(run.frames())} frames over the serial line{sum_text}")
        print(f"  error of the force along {', '.join(axes)}: mean {1e3 * error.mean():.1f} mN, "
              f"95th percentile {1e3 * error_p95:.1f} mN, {100 * error_p95 / largest:.1f} % "
              f"of the largest true force {largest:.2f} N")  # fmt: skip
        for picture in pictures:
            print(f"  {picture}")
    if sums or error_p95 > limit * largest:
        raise CheckFailed(
            f"the main job's figures are not met: field and wrench differ, or the error is above {100 * limit:g} %"
        )


def run_real(board_name: str, out: Path, given: RealInput, *, as_json: bool) -> None:
    """The main job on a real recording without force truth."""
    board = find_board(board_name)
    if not given.video.exists():
        raise InputError(f"{given.video}: no such recording")
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    with _step("calibrate: inverse FEM"), progress_bar("inverse FEM") as progress:
        kind = make_operator(board, method="optimal", noise=NOISE_WITHOUT_DEPTH, progress=progress)
    tensors, metadata = dict(kind.tensors), {**container.base_metadata(board), **kind.metadata}
    if given.presses is not None:
        with _step("calibrate: colour -> slope (other optics)"), progress_bar("photometric") as progress:
            presses = load_presses(given.presses, ball_mm=given.ball_mm, px_per_mm=given.px_per_mm)
            fit = fit_photometric(collect_samples(presses, None), progress=progress)
        tensors.update(tabulate(fit.model))
        metadata["optics"] = "foreign"
    file = container.pack(tensors, metadata)
    container.write(out / "calibration.safetensors", file)
    run = _stream(board, given.video, out, file.data, None, "--lockstep")
    _report_real(board, out, run, given, as_json)


def _report_real(board: Board, out: Path, run: Run, given: RealInput, as_json: bool) -> None:
    frames = [i for i in run.frames() if i >= board.pipeline.n_rest_frames and i in run.results["MARKERS"]]
    motion = np.array([run.results["MARKERS"][i] for i in frames])
    mean = motion.mean(axis=(1, 2))
    shear = np.array([run.results["WRENCH"][i].values[:2] for i in frames])
    begun = np.flatnonzero(np.linalg.norm(motion, axis=-1).mean(axis=(1, 2)) > CONTACT_START_PX)
    n_rest = int(begun[0]) - GUARD_FRAMES if begun.size else len(frames)
    if n_rest < 2:
        raise CheckFailed(f"{given.video}: touched from the start: no untouched frame to judge rest by")
    rest_px = float(np.linalg.norm(motion[:n_rest], axis=-1).max())
    rest_rms_px = np.sqrt((motion[:n_rest] ** 2).mean(axis=(0, 1, 2)))
    # Noise of the total from the first half of the untouched frames, judged on the second half.
    half = n_rest // 2
    sigma = np.sqrt((shear[:half] ** 2).mean(axis=0))
    before = np.abs(shear[half:n_rest]).max(axis=0)
    moving = np.linalg.norm(mean, axis=1) > 1.0
    a, b = shear[moving], mean[moving]
    cosine = (a * b).sum(axis=1) / np.maximum(np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1), 1e-12)
    worst = float(cosine.min()) if moving.any() else float("nan")
    overall = float((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum())) if moving.any() else float("nan")
    strongest = frames[int(np.linalg.norm(mean, axis=1).argmax())]
    got = run.results["FIELD"][strongest]
    flags = Schema.own().enum_names("FlagBit", run.results["WRENCH"][strongest].flags)
    z_state = "UNCALIBRATED" if "FLAG_UNCALIBRATED_Z" in flags else "calibrated"
    image = list(read_frames(given.video))[strongest]
    time_s = np.array([run.results["WRENCH"][i].capture_s for i in frames])
    wrench = np.array([run.results["WRENCH"][i].values for i in frames]) * np.array([1, 1, 1, 1e3, 1e3, 1e3])
    rate_hz = board.camera.rate_mhz * 1e-3
    pictures = [
        field_over_frame(out / "field.png", image, node_pixels(board), node_places(board), got.raw_force,
                         z_calibrated=False, title=f"{board.name}: shear field, frame {strongest} (z UNCALIBRATED)"),
        wrench_over_time(out / "wrench.png", np.array(frames) / rate_hz, wrench,
                         title=f"{board.name}: wrench (z UNCALIBRATED)"),
    ]  # fmt: skip
    foreign = [d for d in run.results["DEPTH"].values() if d.validity == UNCALIBRATED]
    if foreign:
        deepest = min(foreign, key=lambda d: d.raw_depth.min())
        pictures.append(depth_map(out / "depth.png", deepest.raw_depth * 1e6,
                                  place_mm=depth_places(board, 0 * deepest.raw_depth, deepest.step_px) * 1e3,
                                  title=f"{board.name}: depth, frame {deepest.frame} (UNCALIBRATED)"))  # fmt: skip
    within = bool((before <= 3 * sigma).all())
    sums = check_sums(run) if has_field(board) else 0
    result = {
        "board": board.name, "frames": len(run.frames()), "rest_frames": n_rest, "rest_displacement_px": rest_px,
        "rest_displacement_rms_px": float(np.linalg.norm(rest_rms_px)),
        "before_touch_n": before.tolist(), "before_touch_sigma_n": sigma.tolist(),
        "before_touch_within_3_sigma": within,
        "shear_direction_cosine": overall, "shear_direction_cosine_worst_frame": worst, "sum_difference_un": sums,
        "z": z_state,
        "duration_s": float(time_s[-1] - time_s[0]), "pictures": [str(p) for p in pictures],
    }  # fmt: skip
    if as_json:
        print(json.dumps(result))
    else:
        print(f"{board.name}: {len(run.frames())} frames of {given.video} over the serial line; z {z_state}")
        print(
            f"  rest: largest displacement {rest_px:.3f} px (limit {MAX_REST_PX}), "
            f"RMS {np.linalg.norm(rest_rms_px):.3f} px, {n_rest} frames"
        )
        print(f"  before touch: largest total shear {1e3 * before[0]:.1f}, {1e3 * before[1]:.1f} mN in any frame, "
              f"sigma from other untouched frames {1e3 * sigma[0]:.1f}, {1e3 * sigma[1]:.1f} mN "
              f"(within 3 sigma: {within})")  # fmt: skip
        print(
            f"  direction of total shear against mean dot motion: cosine {overall:.3f}, "
            f"worst frame {worst:.3f} (limit {MIN_COSINE})"
        )
        for picture in pictures:
            print(f"  {picture}")
    if rest_px > MAX_REST_PX or not within or not overall >= MIN_COSINE or sums:
        raise CheckFailed("the main job's figures on this recording are not met")
