"""Colours of a camera with a lens: labels by the measured camera are the true surface, by a pinhole they are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.cli.app import app
from ruffini.errors import InputError
from ruffini.estimators.camera.fit import CameraModel, Lens, tables
from ruffini.estimators.photometric.fit import angle_deg
from ruffini.estimators.photometric.pad_view import MappedCamera, PadView, Pinhole, mm_per_px, pad_view
from ruffini.estimators.photometric.presses import Press, ball_slope
from ruffini.sim.optics.camera import View
from ruffini.sim.optics.settings import LensSettings, ViewSettings
from ruffini.sim.recording import record_balls
from ruffini.sim.settings import MeshSettings, load_twin
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelslim")
K1, K2 = -0.40, 0.10
LENS = LensSettings(model="radtan", coefficients_1e6=[round(K1 * 1e6), round(K2 * 1e6), 0, 0, 0])
MATRIX = np.array([[300.0, 0, 159.5], [0, 300.0, 119.5], [0, 0, 1]])
PLACES_MM = [(7.5, 5.5), (-7.5, 5.5), (7.5, -5.5), (0.5, 0.5)]  # three corners and the middle
RADIUS_MM, CONTACT_MM = 2.5, 1.2


@pytest.fixture(scope="module")
def camera() -> container.CalibrationFile:
    """The camera as `cal fit --only camera` would have it, of the true lens."""
    lens = Lens(MATRIX, np.array([K1, K2, 0, 0, 0]), False)
    tensors, metadata = tables(CameraModel(lens, np.eye(3), np.array([0, 0, -20.0])), BOARD)
    return container.unpack(container.pack({**tensors}, {**container.base_metadata(BOARD), **metadata}).data)


def label_error_deg(view: PadView) -> Array:
    """Median angle between the labels of a ball's contact and the ball that the twin's rays meet, for each place."""
    eye, errors = View(BOARD, ViewSettings(), LENS), []
    origin, ray = eye.rays()
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    for place in PLACES_MM:
        edge_z = -(CONTACT_MM**2) / (2 * RADIUS_MM)  # Hertz
        middle = np.array([*place, edge_z + np.sqrt(RADIUS_MM**2 - CONTACT_MM**2)])
        rim = np.column_stack(
            [place + CONTACT_MM * np.stack([np.cos(angle), np.sin(angle)], axis=1), 0 * angle + edge_z]
        )
        rim_px = eye.project(rim)[0]
        center = rim_px.mean(axis=0)
        press = Press(Path("press.png"), *center, np.linalg.norm(rim_px - center, axis=1).mean())
        shape = (BOARD.camera.height_px, BOARD.camera.width_px)
        mask, slope = ball_slope(press, shape, ball_radius_mm=RADIUS_MM, px_per_mm=15.0, camera=view)
        o, d = origin[mask] - middle, ray[mask]  # meets the ball's lower half first
        dd, od = (d**2).sum(axis=1), (o * d).sum(axis=1)
        along = (-od - np.sqrt(od**2 - dd * ((o**2).sum(axis=1) - RADIUS_MM**2))) / dd
        seen = o + along[:, None] * d
        errors.append(float(np.median(angle_deg(slope, -seen[:, :2] / seen[:, 2:]))))
    return np.array(errors)


def test_labels_of_the_measured_camera_are_the_ball(camera: container.CalibrationFile) -> None:
    by_pinhole = label_error_deg(pad_view(BOARD, {}, {}))
    by_map = label_error_deg(pad_view(BOARD, camera.tensors, camera.metadata))
    assert (by_pinhole[:3] > 2).all()  # towards the corners, where the lens bends
    assert (by_map < 1).all()  # a bent circle is no circle


def test_the_table_is_the_pinhole_where_there_is_no_lens() -> None:
    lens = Lens(MATRIX, np.zeros(5), False)
    tensors, metadata = tables(CameraModel(lens, np.eye(3), np.array([0, 0, -20.0])), BOARD)
    mapped, pinhole = pad_view(BOARD, {**tensors}, metadata), pad_view(BOARD, {}, {})
    assert isinstance(mapped, MappedCamera)
    assert isinstance(pinhole, Pinhole)
    px = np.random.default_rng(0).uniform([0, 0], [319, 239], (200, 2))
    for seen, true in zip(mapped.rays(px), pinhole.rays(px), strict=True):
        np.testing.assert_allclose(seen, true, atol=1e-4)
    assert mm_per_px(mapped, np.array([200.0, 50.0]), -1.0) == pytest.approx(19 / 300, rel=1e-3)


def test_the_verb_takes_the_camera(
    camera: container.CalibrationFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "balls"
    twin = load_twin(BOARD).model_copy(update={"mesh": MeshSettings(cells_x=10, cells_y=8)})
    record_balls(kept(TwinUnit.build, BOARD, twin=twin), 3, folder, ball_mm=2 * RADIUS_MM, seed=5)
    container.write(tmp_path / "camera", camera)
    words = [
        "cal",
        "fit",
        "--only",
        "photometric",
        str(folder),
        "--board",
        str(BOARD.folder),
        "--out",
        str(tmp_path / "out"),
    ]

    def looked_at(_: MappedCamera, px: Array) -> tuple[Array, Array]:
        raise InputError(f"{len(px)} pixels looked at by the map")

    monkeypatch.setattr(MappedCamera, "rays", looked_at)
    done = CliRunner().invoke(app, [*words, "--camera", str(tmp_path / "camera")])
    assert "pixels looked at by the map" in str(done.exception)
    container.write(tmp_path / "none", container.pack({"rest.image": np.zeros((1, 1, 3), np.uint16)}, camera.metadata))
    assert "has no camera table" in str(CliRunner().invoke(app, [*words, "--camera", str(tmp_path / "none")]).exception)
