"""A tiny sensor for end-to-end tests: drawn frames, a real calibration, the real ruffinid on a real pty."""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from hang import HANG_S
from kept import kept

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.daemon import find_daemon
from ruffini.device import Connection
from ruffini.estimators.operator.fit import make_operator
from ruffini.fem.operators import Noise

ROOT = Path(__file__).parents[2]
N_REST, N_FRAMES = 10, 40
MILLI_CELSIUS = 36_600  # in the file that stands for the board's thermometer
COLOUR_OF_SLOPE = 0.5

TINY = {
    'name = "sample"': 'name = "tiny"',
    "width_px = 320": "width_px = 160", "height_px = 240": "height_px = 120",
    "focal_mpx = 300000": "focal_mpx = 150000",
    "center_x_mpx = 159500": "center_x_mpx = 79500", "center_y_mpx = 119500": "center_y_mpx = 59500",
    "n_x = 31": "n_x = 17", "n_y = 25": "n_y = 13", "n_layers = 6": "n_layers = 4",
    "n_x = 19": "n_x = 9", "n_y = 15": "n_y = 7", "pitch_x_um = 1000": "pitch_x_um = 2000",
    "pitch_y_um = 1000": "pitch_y_um = 2000", "first_x_um = 1000": "first_x_um = 2000",
    "max_lost = 30": "max_lost = 6",  # a tenth of them, as on the board
    "first_y_um = 1000": "first_y_um = 2000", "diameter_um = 400": "diameter_um = 800", "step_px = 2": "step_px = 1",
}  # fmt: skip


@dataclass(frozen=True)
class Sensor:
    """Folders of a sensor that can be started."""

    board: Board
    folder: Path
    recording: Path
    calibration: bytes


def write_board(folder: Path, changes: dict[str, str]) -> Path:
    """The test board with some lines changed, in a folder of the board's name."""
    text = (ROOT / "tests" / "data" / "boards" / "base.toml").read_text()
    for old, new in {**TINY, **changes}.items():
        assert old in text, old
        text = text.replace(old, new, 1)
    folder.mkdir(parents=True)
    thermometer = folder / "temp1_input"
    thermometer.write_text(f"{MILLI_CELSIUS}\n")
    (folder / "board.toml").write_text(f'{text}\n[temperature]\nplace = "gel"\npath = "{thermometer}"\n')
    return folder


def draw(board: Board, depth: float, seed: int) -> np.ndarray:
    """Dots on a grey pad and, where pressed, a coloured dent that pulls the dots inwards."""
    rng = np.random.default_rng(seed)
    c, m = board.camera, board.markers
    px_per_um = c.focal_mpx / 1e3 / c.standoff_um
    center = np.array([c.center_x_mpx, c.center_y_mpx]) / 1e3
    y, x = np.mgrid[: c.height_px, : c.width_px].astype(float)
    radius = 3000 * px_per_um
    inside = np.maximum(1 - ((x - center[0]) ** 2 + (y - center[1]) ** 2) / radius**2, 0)
    slope = np.stack([(x - center[0]), (y - center[1]), 0 * x], axis=2) * (4 * depth / radius) * inside[..., None]
    level = 120 * (1 + COLOUR_OF_SLOPE * slope)
    lattice = np.stack(
        np.meshgrid(
            (m.first_x_um + np.arange(m.n_x) * m.pitch_x_um - board.pad.size_x_um / 2) * px_per_um,
            (m.first_y_um + np.arange(m.n_y) * m.pitch_y_um - board.pad.size_y_um / 2) * px_per_um,
        ),
        axis=-1,
    ).reshape(-1, 2)
    reach = m.diameter_um / 2 * px_per_um + 0.5
    for away in lattice:
        place = center + away * (1 - 0.1 * depth * max(1 - (away @ away) / radius**2, 0))
        dot = tuple(slice(max(int(at - reach), 0), max(int(at + reach) + 2, 0)) for at in place[::-1])
        distance = np.hypot(x[dot] - place[0], y[dot] - place[1])
        level[dot] *= 1 - 0.6 * np.clip(reach - distance, 0, 1)[..., None]
    return np.clip(np.round(level + rng.normal(0, 0.7, level.shape)), 0, 255).astype(np.uint8)


def write_recording(board: Board, folder: Path, n_frames: int = N_FRAMES) -> Path:
    """Rest, then a press that grows and stays."""
    (folder / "frames").mkdir(parents=True)
    for i in range(n_frames):
        depth = 0.25 * min(max(i - N_REST, 0) / 10, 1)
        cv2.imwrite(str(folder / "frames" / f"{i:04d}.png"), draw(board, depth, i))
    (folder / "recording.toml").write_text(f'simulated = true\nboard = "{board.name}"\nrate_mhz = 100000\n')
    return folder


def make_calibration(board: Board) -> container.CalibrationFile:
    """Operator, second pass and a colour table that fits `draw`."""
    kind = make_operator(board, method="support", noise=Noise((5e-6, 5e-6, 20e-6), gauge_m=100e-6, tilt_m=30e-6))
    axis = np.linspace(-1, 1, 65)
    q_y, q_x = np.meshgrid(axis, axis, indexing="ij")
    length = np.minimum(np.hypot(q_x, q_y), 0.97)
    slope = np.stack([q_x, q_y], axis=2) / np.sqrt(1 - length**2)[..., None]
    unmix = np.zeros((13, 17, 2, 3), np.int16)
    unmix[..., 0, 0] = unmix[..., 1, 1] = round(4096 / COLOUR_OF_SLOPE)
    tables = {
        **kind.tensors,
        "photometric.unmix": unmix,
        "photometric.slope": np.clip(np.round(slope * 4096), -32767, 32767).astype(np.int16),
    }
    for check in ("support.spread", "support.spread_limit"):  # rubber does not move as `draw` does
        del tables[check]
    return container.pack(tables, {**container.base_metadata(board), **kind.metadata})


def make_sensor(root: Path) -> Sensor:
    """Board, recording and calibration, in folders of `root`."""
    folder = write_board(root / "tiny", {})
    board = find_board(folder)
    return Sensor(board, folder, write_recording(board, root / "recording"), kept(calibration_bytes, board))


def calibration_bytes(board: Board) -> bytes:
    """Of `make_calibration`, which takes a second."""
    return make_calibration(board).data


class Daemon:
    """A running ruffinid."""

    def __init__(self, process: subprocess.Popen[str], port: str) -> None:
        self.process, self.port = process, port


@contextlib.contextmanager
def start(sensor: Sensor, store: Path, *options: str, serial: str = "0001", link: str = "pty") -> Iterator[Daemon]:
    """ruffinid on the sensor's recording and a new pty, or the given line."""
    command = [
        str(find_daemon()), "--board", str(sensor.folder), "--camera", f"replay:{sensor.recording}",
        "--link", link, "--store", str(store), "--serial", serial, *options,
    ]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("link: "), process.stderr.read() if process.stderr else line
        yield Daemon(process, line.removeprefix("link: ").strip())
    finally:
        process.kill()
        process.communicate(timeout=HANG_S)


@contextlib.contextmanager
def calibrated_pair(sensor: Sensor, folder: Path) -> Iterator[tuple[Daemon, Daemon]]:
    """Two sensors, left and right, with their calibration."""
    with (
        start(sensor, folder / "left", "--loop", serial="left") as left,
        start(sensor, folder / "right", "--loop", serial="right") as right,
    ):
        for daemon in (left, right):
            with Connection(daemon.port) as host:
                host.flash(sensor.calibration)
        yield left, right
