"""`ruffini eval photometric` on drawn presses whose circles, normals and heights are known."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
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
from ruffini.estimators.photometric.fit import collect_samples, fit_photometric, tabulate
from ruffini.estimators.photometric.presses import load_presses, reference_images
from ruffini.evaluate.photometric import evaluate, table

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelsight-mini")
BALL_MM, PX_PER_MM = 5.0, 300 / 19.02  # the scale of BOARD
LAMPS = np.array([[0.5, 0.1], [-0.2, 0.45], [-0.25, -0.5]])  # relative change of B, G, R per unit normal x, y
Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]


def draw(rng: np.random.Generator, size: tuple[int, int], circle: tuple[float, float, float] | None) -> Picture:
    """A ball's cap, its slope fading over a radius outside the contact; light Lambertian in the normal's x and y."""
    height, width = size
    y, x = np.mgrid[:height, :width].astype(float)
    normal = np.zeros((*size, 2))
    if circle is not None:
        dx, dy = x - circle[0], y - circle[1]
        away = np.hypot(dx, dy)
        fade = np.clip(2 - away / circle[2], 0, 1)
        held = np.minimum(away, circle[2]) / np.maximum(away, 1e-9)
        normal = np.stack([dx, dy], axis=-1) * (held * fade / (BALL_MM / 2 * PX_PER_MM))[..., None]
    level = 120 * (1 + normal @ LAMPS.T) + rng.normal(0, 1, (*size, 3))
    return np.asarray(np.clip(np.round(level), 0, 255), dtype=np.uint8)


def write(folder: Path, size: tuple[int, int], n: int, off_px: float = 0.0) -> Path:
    """n presses; the table's circles are off by `off_px` along x."""
    rng = np.random.default_rng(3)
    folder.mkdir()
    for i in range(4):
        cv2.imwrite(str(folder / f"reference_{i}.png"), draw(rng, size, None))
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    for i in range(n):
        circle = (rng.uniform(60, size[1] - 60), rng.uniform(55, size[0] - 55), rng.uniform(22, 30))
        cv2.imwrite(str(folder / f"{i}.png"), draw(rng, size, circle))
        lines.append(f"{i}.png,{circle[0] + off_px:.2f},{circle[1]:.2f},{circle[2]:.2f}")
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    return folder


def calibrate(folder: Path, out: Path) -> Path:
    fit = kept(fit_photometric, collect_samples(load_presses(folder), None))
    container.write(out, container.pack(dict(tabulate(fit.model)), container.base_metadata(BOARD)))
    return out


@pytest.fixture(scope="module")
def calibration(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fit")
    return calibrate(write(root / "presses", (160, 200), 10), root / "colours.safetensors")


# The board's own view is in perspective, which the drawing is not: a tenth of the height.
@pytest.mark.parametrize(
    ("size", "is_own", "worst_deg", "height"), [((160, 200), False, 4, 0.06), ((240, 320), True, 5, 0.15)]
)
def test_presses_with_a_known_truth(
    calibration: Path, tmp_path: Path, size: tuple[int, int], is_own: bool, worst_deg: float, height: float
) -> None:
    folder = write(tmp_path / "presses", size, 3)
    judged = evaluate(load_presses(folder), container.read(calibration), BOARD, [], reference_images(folder))[0]
    assert judged["is_own_view"] is is_own
    assert judged["n_presses"] == 3
    assert judged["marked"]["normal_worst_deg"] < worst_deg
    assert judged["marked"]["cap_worst_mm"] < 0.05
    assert judged["marked"]["peak_to_edge_median"] == pytest.approx(1, abs=height)
    assert len(judged["untouched"]["rms_um"]) == 4
    assert 0 < judged["untouched"]["worst_um"] < 60
    assert "peak to edge" in table(judged)


def test_a_circle_marked_beside_is_put_right(calibration: Path, tmp_path: Path) -> None:
    folder = write(tmp_path / "presses", (160, 200), 3, off_px=1.5)
    judged = evaluate(load_presses(folder), container.read(calibration), BOARD, [], reference_images(folder))[0]
    for row in judged["presses"]:
        assert row["correction_px"][0] == pytest.approx(-1.5, abs=0.6)
    assert judged["refitted"]["normal_median_deg"] < judged["marked"]["normal_median_deg"] - 1


def test_a_table_of_other_colours_is_told(calibration: Path, tmp_path: Path) -> None:
    file = container.read(calibration)
    wrong = dict(file.tensors)
    wrong["photometric.unmix"] = (wrong["photometric.unmix"] // 2).astype(np.int16)
    folder = write(tmp_path / "presses", (160, 200), 3)
    flat = container.pack(wrong, file.metadata)
    judged = evaluate(load_presses(folder), flat, BOARD, [], reference_images(folder))[0]
    assert judged["marked"]["peak_to_edge_median"] < 0.6
    assert judged["marked"]["normal_median_deg"] > 8


TURN = 0.12  # of the camera about the image's x
LENS = Lens(np.array([[270.0, 0, 163], [0, 270.0, 117], [0, 0, 1]]), np.array([-0.35, 0.1, 0, 0, 0]), False)


def bent_camera() -> CameraModel:
    """A lens of strong barrel distortion, mounted askew, that looks at the pad from about where the board says."""
    c, s = np.cos(TURN), np.sin(TURN)
    turn = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    middle = LENS.directions(np.array([[159.5, 119.5]]))[0] @ turn.T
    distance_mm = 270 / PX_PER_MM
    return CameraModel(LENS, turn, -middle / middle[2] * distance_mm)


def draw_through(
    px: Array, rays: tuple[Array, Array], rng: np.random.Generator, touch_mm: Array | None
) -> tuple[Picture, Array]:
    """What a camera sees of a flat pad with a ball pressed into it, ray by ray; contact's middle and radius, px."""
    contact_mm = 1.5
    place_um, slope = rays
    normal, circle = np.zeros((len(px), 2)), np.zeros(3)
    if touch_mm is not None:
        rim = -(contact_mm**2) / BALL_MM
        center = rim + np.sqrt(BALL_MM**2 / 4 - contact_mm**2)
        start = np.column_stack([place_um / 1e3 - touch_mm, np.full(len(px), -center)])
        way = np.column_stack([slope, np.ones(len(px))])
        a, b = (way**2).sum(axis=1), (start * way).sum(axis=1)
        inside = b**2 - a * ((start**2).sum(axis=1) - BALL_MM**2 / 4)
        on_ball = start + ((-b - np.sqrt(np.maximum(inside, 0))) / a)[:, None] * way
        away = np.hypot(*on_ball[:, :2].T)
        is_held = (inside > 0) & (away < contact_mm)
        free = place_um / 1e3 + rim * slope - touch_mm
        away_free = np.maximum(np.hypot(*free.T), contact_mm)
        fade = np.clip(2 - away_free / contact_mm, 0, 1) * contact_mm / away_free
        normal = np.where(is_held[:, None], on_ball[:, :2], free * fade[:, None]) / (BALL_MM / 2)
        circle = np.array([*px[is_held].mean(axis=0), np.sqrt(is_held.sum() / np.pi)])
    level = 120 * (1 + normal @ LAMPS.T) + rng.normal(0, 1, (len(px), 3))
    return np.asarray(np.clip(np.round(level), 0, 255).reshape(240, 320, 3), dtype=np.uint8), circle


def test_presses_through_a_bent_lens_are_judged_by_the_camera_as_measured(calibration: Path, tmp_path: Path) -> None:
    rng, camera, folder = np.random.default_rng(6), bent_camera(), tmp_path / "presses"
    px = np.stack(np.meshgrid(np.arange(320), np.arange(240)), axis=-1).reshape(-1, 2).astype(float)
    rays = camera.rays(px)
    folder.mkdir()
    cv2.imwrite(str(folder / "reference.png"), draw_through(px, rays, rng, None)[0])
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    for i, touch_mm in enumerate(np.array([[-5.5, -3.5], [0.5, 0.3], [5.0, 3.5]])):
        picture, (x, y, r) = draw_through(px, rays, rng, touch_mm)
        cv2.imwrite(str(folder / f"{i}.png"), picture)
        lines.append(f"{i}.png,{x:.2f},{y:.2f},{r:.2f}")
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    colours = container.read(calibration)
    measured, metadata = tables(camera, BOARD)
    whole = container.pack({**colours.tensors, **measured}, {**container.base_metadata(BOARD), **metadata})
    as_measured, as_pinhole = (
        evaluate(load_presses(folder), file, BOARD, [], reference_images(folder))[0] for file in (whole, colours)
    )
    assert as_measured["has_measured_camera"]
    assert "camera as measured" in table(as_measured)
    assert not as_pinhole["has_measured_camera"]
    assert as_measured["refitted"]["normal_worst_deg"] < 0.8
    assert as_measured["marked"]["normal_worst_deg"] < 2.0 < as_pinhole["marked"]["normal_worst_deg"] - 1
    assert as_pinhole["refitted"]["normal_median_deg"] > 2 * as_measured["refitted"]["normal_median_deg"]
    for height in ("peak_to_edge_least", "peak_to_edge_most"):
        assert as_measured["marked"][height] == pytest.approx(1, abs=0.05)
    assert as_pinhole["marked"]["peak_to_edge_most"] > 1.08


def test_the_verb(calibration: Path, tmp_path: Path) -> None:
    folder = write(tmp_path / "presses", (160, 200), 3)
    picture = tmp_path / "press.png"
    arguments = ["eval", "photometric", str(folder), "--calibration", str(calibration), "--out", str(picture)]
    done = CliRunner().invoke(app, [*arguments, "--board", str(BOARD.folder), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert [row["image"] for row in result["presses"]] == ["0.png", "1.png", "2.png"]
    assert np.asarray(cv2.imread(result["picture"])).std() > 10


def test_the_page_judges_each_press_by_a_table_of_the_others(tmp_path: Path) -> None:
    folder, page = write(tmp_path / "presses", (160, 200), 6, off_px=1.5), tmp_path / "page.html"
    words = [
        "cal",
        "fit",
        "--only",
        "photometric",
        str(folder),
        "--board",
        str(BOARD.folder),
        "--foreign",
        "--report",
        str(page),
    ]
    done = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "c.safetensors"), "--json"])
    assert done.exit_code == 0, done.output
    result = json.loads(page.with_suffix(".json").read_text())
    assert json.loads(done.stdout)["files"] == [str(page), str(page.with_suffix(".json"))]
    assert [row["image"] for row in result["presses"]] == [f"{i}.png" for i in range(6)]
    for row in result["presses"]:
        assert row["correction_px"][0] == pytest.approx(-1.5, abs=0.6)
        assert row["mark_off_px"] == pytest.approx(1.5, abs=0.5)
        assert row["clipped_share"] == 0
    assert result["refitted"]["normal_worst_deg"] < 4
    assert "other presses" in result["judged_by"]
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 2
    assert all(f">{i}.png<" in text for i in range(6))


def test_what_cannot_be_judged(calibration: Path, tmp_path: Path) -> None:
    folder = write(tmp_path / "presses", (160, 200), 3)
    operator = tmp_path / "operator.safetensors"
    tensors = {"rest.image": np.zeros((2, 2, 3), np.uint16)}
    container.write(operator, container.pack(tensors, container.base_metadata(BOARD)))
    board = ["--board", str(BOARD.folder)]
    words = ["eval", "photometric", str(folder), "--calibration", str(operator), *board]
    assert "no photometric table" in str(CliRunner().invoke(app, words).exception)
    empty = tmp_path / "empty"
    empty.mkdir()
    words = ["eval", "photometric", str(folder), "--calibration", str(calibration), *board, "--untouched", str(empty)]
    assert "holds no PNG or JPEG" in str(CliRunner().invoke(app, words).exception)
    cv2.imwrite(str(folder / "1.png"), np.zeros((10, 10, 3), np.uint8))
    with pytest.raises(InputError, match="one size is needed"):
        evaluate(load_presses(folder), container.read(calibration), BOARD, [], reference_images(folder))
