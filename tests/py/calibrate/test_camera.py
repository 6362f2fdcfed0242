"""cal camera on pictures by the twin's own lens: the lens comes back, and with it displacement in micrometres."""

from __future__ import annotations

import itertools
import json
import tempfile
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from typer.testing import CliRunner

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.cli.app import app
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.camera.fit import CameraFit, fit_camera, tables
from ruffini.estimators.camera.targets import Target
from ruffini.sim.optics.camera import View, rotation
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.optics.settings import GelSettings, LensSettings, ViewSettings
from ruffini.sim.settings import load_twin

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

BOARD = find_board(Path(__file__).parents[3] / "boards" / "gelslim")
RADTAN = LensSettings(model="radtan", coefficients_1e6=[-180_000, 60_000, 2_000, -1_500, 0])
FISHEYE = LensSettings(model="fisheye", coefficients_1e6=[-40_000, 10_000, 0, 0])
CHESSBOARD = Target("chessboard", 9, 6, 1.8)
INDEX = 1.41
SIDES = list(itertools.product((-1, 1), (-1, 1)))
# Turn (rad), distance (mm), sideways (mm): from straight above and from all sides, into the corners of the image.
POSES = [
    ((0, 0, 0), 20, (0, 0)),
    *(((0.35 * y, -0.35 * x, 0.1), 22, (3.2 * x, 2.6 * y)) for x, y in SIDES),
    *(((-0.3 * y, 0.3 * x, -0.1), 21, (1.2 * x, 0.9 * y)) for x, y in SIDES),
    ((0.4, 0, 0), 23, (0, 0)),
    ((0, 0.4, 0), 23, (0, 0)),
]


def on_target(view: View, turn: tuple[float, ...], away_mm: float, beside_mm: tuple[float, float]) -> Array:
    """Place on a flat target, (h, w, 2) mm, that each pixel of the twin's view sees."""
    origin, ray = view.rays()
    axes, middle = rotation(np.array(turn)), np.array([*beside_mm, away_mm - BOARD.camera.standoff_um * 1e-3])
    along = ((middle - origin) @ axes[:, 2]) / (ray @ axes[:, 2])
    return np.asarray(((origin + along[..., None] * ray - middle) @ axes)[..., :2])


def expose(level: Array, seed: int) -> Picture:
    soft = cv2.GaussianBlur(level, (0, 0), 0.6) + np.random.default_rng(seed).normal(0, 1.5, level.shape)
    return np.repeat(np.clip(soft, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def chessboard(place_mm: Array, seed: int) -> Picture:
    u, v = place_mm[..., 0] / 1.8 + 4, place_mm[..., 1] / 1.8 + 2.5
    inside = (u > -1) & (u < 9) & (v > -1) & (v < 6)
    return expose(np.where(inside, 120 - 80 * np.tanh(6 * np.sin(np.pi * u) * np.sin(np.pi * v)), 200), seed)


def dots(place_mm: Array, seed: int) -> Picture:
    u, v = place_mm[..., 0] / 2.5 + 3, place_mm[..., 1] / 2.5 + 2
    away = np.hypot(u - np.clip(np.round(u), 0, 6), v - np.clip(np.round(v), 0, 4))
    return expose(120 - 80 * np.tanh(20 * (away - 0.25)), seed)


def charuco(place_mm: Array, seed: int) -> Picture:
    drawn = np.asarray(Target("charuco", 7, 5, 2.5).charuco_board().generateImage((1400, 1000), marginSize=0))
    at = (place_mm / 2.5 + [3.5, 2.5]) * 200 - 0.5
    level = cv2.remap(cv2.GaussianBlur(drawn, (0, 0), 6), at[..., 0].astype(np.float32), at[..., 1].astype(np.float32),
                      cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=255)  # fmt: skip
    return expose(40 + level * 0.7, seed)


def pictures(folder: Path, lens: LensSettings | None) -> list[Path]:
    view, paths = View(BOARD, ViewSettings(), lens), []
    for i, (turn, away, beside) in enumerate(POSES):
        paths.append(folder / f"{i:02d}.png")
        cv2.imwrite(str(paths[-1]), chessboard(on_target(view, turn, away, beside), i))
    return paths


@pytest.fixture(scope="module")
def radtan_views(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return pictures(tmp_path_factory.mktemp("radtan"), RADTAN)


def fit(paths: list[Path], **more: object) -> CameraFit:
    options = {"is_fisheye": False, "on_pad": None, "index": 1.0, **more}
    return fit_camera(paths, CHESSBOARD, BOARD, **options)  # type: ignore[arg-type]


def errors_um(lens: LensSettings, index: float, *calibrations: bytes | None) -> list[float]:
    """By each: RMS error of the nodes' displacement for a known motion of the twin's surface without depth."""

    def field(x: Array, y: Array) -> Array:
        return np.stack([0.35 + 0.02 * x - 0.01 * y, -0.25 + 0.01 * x + 0.015 * y, 0 * x], axis=-1)

    tree = load_twin(BOARD).model_copy(
        update={"lens": lens, "gel": GelSettings(index_1e3=round(index * 1000)) if index != 1 else None}
    )
    renderer = Renderer.over_chart(BOARD, tree)
    moved = field(*np.meshgrid(renderer.node_a_mm, renderer.node_b_mm)) * 1e-3
    rest, shifted = (
        renderer.image(surface, np.random.default_rng(seed)) for seed, surface in enumerate((renderer.at_rest(), moved))
    )
    rows, columns = BOARD.observed
    pad, grid = BOARD.pad, BOARD.grid
    x = np.linspace(-pad.size_x_um / 2e3, pad.size_x_um / 2e3, grid.n_x)[columns]
    y = np.linspace(-pad.size_y_um / 2e3, pad.size_y_um / 2e3, grid.n_y)[rows]
    true_um, out = field(*np.meshgrid(x, y))[..., :2] * 1e3, []
    for calibration in calibrations:
        with Pipeline(BOARD, calibration) as pipeline:
            pipeline.set_rest(rest)
            assert pipeline.process(shifted).n_markers_lost == 0
            off = np.linalg.norm(pipeline.displacement_m()[..., :2] * 1e6 - true_um, axis=-1)
        out.append(float(np.sqrt((off**2).mean())))
    return out


def fitted(lens: LensSettings, index: float) -> CameraFit:
    with tempfile.TemporaryDirectory() as folder:
        return fit(pictures(Path(folder), lens), is_fisheye=lens.model == "fisheye", index=index)


@pytest.mark.parametrize(("lens", "index"), [(RADTAN, 1.0), (RADTAN, INDEX), (FISHEYE, INDEX)])
def test_displacement_before_and_after(lens: LensSettings, index: float) -> None:
    found = kept(fitted, lens, index)
    tensors, metadata = tables(found.model, BOARD)
    file = container.pack({**tensors}, {**container.base_metadata(BOARD), **metadata})
    before, after = errors_um(lens, index, None, file.data)
    assert before > 25
    assert after < 9
    assert after < before / 3
    assert 0.4 < found.report()["residual_um"] < 9


def test_the_lens_comes_back(radtan_views: list[Path]) -> None:
    report = fit(radtan_views).report()
    np.testing.assert_allclose(report["focal_px"], 300, rtol=3e-3)
    np.testing.assert_allclose(report["center_px"], [159.5, 119.5], atol=1.0)
    np.testing.assert_allclose(report["distortion"][:4], [-0.18, 0.06, 0.002, -0.0015], atol=0.02)
    assert 0.01 < report["residual_px"] < 0.12


def test_rays_are_the_twins_through_lens_and_gel(radtan_views: list[Path]) -> None:
    """A point below the surface is seen where the twin, which traces rays on its own, sees it."""
    model = fit(radtan_views, index=INDEX).model
    origin, ray = View(BOARD, ViewSettings(), RADTAN, 1, INDEX).rays()
    v, u = np.mgrid[20:221:50, 30:291:52]
    place, slope = model.rays(np.column_stack([u.ravel(), v.ravel()]).astype(float))
    for depth_mm in (0.0, -0.8):
        away = (depth_mm - origin[..., 2]) / ray[..., 2]
        truth = (origin + away[..., None] * ray)[v, u, :2].reshape(-1, 2) * 1e3
        off = np.linalg.norm(place + slope * depth_mm * 1e3 - truth, axis=1)
        assert np.sqrt((off**2).mean()) < 10


def test_a_camera_that_is_mounted_askew(radtan_views: list[Path], tmp_path: Path) -> None:
    """The picture of the target on the pad tells turn and shift; the pad's centre is what the principal point sees."""
    askew = ViewSettings(offset_um=[300, -200, 400], turn_mrad=[40, -30, 0])
    view, picture = View(BOARD, askew, RADTAN), tmp_path / "pad.png"
    cv2.imwrite(str(picture), chessboard(on_target(view, (0, 0, 0), 20, (0, 0)), 5))
    model = fit(radtan_views, on_pad=picture).model
    origin, ray = (part.reshape(-1, 3) for part in view.rays())
    truth = (origin - origin[:, 2:] / ray[:, 2:] * ray)[:, :2] * 1e3
    v, u = np.mgrid[: BOARD.camera.height_px : 24, : BOARD.camera.width_px : 32]
    pick = (v * BOARD.camera.width_px + u).ravel()
    place, _ = model.rays(np.column_stack([u.ravel(), v.ravel()]).astype(float))
    # The same plane up to the choice of centre and of the x axis: a shift and a small turn.
    a, b = place - place.mean(axis=0), truth[pick] - truth[pick].mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    off = np.linalg.norm(a @ (left @ right) - b, axis=1)
    assert np.sqrt((off**2).mean()) < 35  # of 20 mm; taken for upright it is 400
    assert abs(model.pinhole_mm[2] + 19.6) < 0.1


@pytest.mark.parametrize(
    ("target", "draw"),
    [(Target("dots", 7, 5, 2.5), dots), (Target("charuco", 7, 5, 2.5), charuco), (CHESSBOARD, chessboard)],
)
def test_every_kind_of_target(target: Target, draw: object) -> None:
    assert callable(draw)
    view = View(BOARD, ViewSettings(), None)
    found = target.find(draw(on_target(view, (0, 0, 0.05), 22, (0.2, -0.1)), 1))
    assert found is not None
    px, mm = found
    assert len(px) >= 20
    shift = mm - mm.mean(axis=0)
    fitted = np.linalg.lstsq(np.column_stack([shift, np.ones(len(mm))]), px, rcond=None)[0]
    off = np.column_stack([shift, np.ones(len(mm))]) @ fitted - px
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15
    assert np.linalg.norm(fitted[0]) == pytest.approx(300 / 22, rel=0.01)


def blank(folder: Path, size: tuple[int, int] = (240, 320)) -> Path:
    cv2.imwrite(str(folder / "blank.png"), np.full((*size, 3), 90, np.uint8))
    return folder / "blank.png"


def test_pictures_that_tell_no_lens(radtan_views: list[Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no chessboard of 9x6 found in any of 1 images"):
        fit([blank(tmp_path)])
    with pytest.raises(InputError, match="seen in 2 images: at least 4"):
        fit([*radtan_views[:2], blank(tmp_path)])
    with pytest.raises(InputError, match=r"blank\.png: no chessboard"):
        fit(radtan_views, on_pad=blank(tmp_path))
    with pytest.raises(InputError, match="is 200x100, board 'gelslim' needs 320x240"):
        fit([*radtan_views, blank(tmp_path, (100, 200))])
    with pytest.raises(InputError, match="3 to 100 a side"):
        Target("dots", 2, 7, 1.0)
    with pytest.raises(InputError, match="pitch"):
        Target("dots", 5, 7, 0.0)


def test_the_verb(radtan_views: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "camera.safetensors"
    words = [
        "cal",
        "fit",
        "--only",
        "camera",
        str(radtan_views[0].parent),
        "--board",
        str(BOARD.folder),
        "--target",
        "chessboard",
    ]
    done = CliRunner().invoke(app, [*words, "--size", "9x6", "--pitch-mm", "1.8", "--out", str(out), "--json"])
    assert done.exit_code == 0, done.output
    report = json.loads(done.stdout)
    assert report["views"] + len(report["skipped"]) == len(POSES)
    file = container.read(out)
    assert file.kinds == ["camera"]
    Pipeline(BOARD, file.data).close()
    bad = CliRunner().invoke(app, [*words, "--size", "9", "--pitch-mm", "1.8", "--out", str(out)])
    assert "COLUMNSxROWS" in str(bad.exception)


def refused(board: Board, change: dict[str, npt.NDArray[np.int32]], **metadata: str) -> str:
    n_x, n_y, step = 81, 61, board.depth.step_px
    sound = {
        "camera.rays": np.zeros((n_y, n_x, 4), np.int32),
        "camera.source": np.zeros((240 // step, 320 // step, 2), np.int32),
    }
    said = {"camera.step_log2": "2", "camera.focal_mpx": "300000", "camera.standoff_um": "20000", **metadata}
    file = container.pack({**sound, **change}, {**container.base_metadata(board), **said})
    try:
        Pipeline(board, file.data).close()
    except InputError as error:
        return str(error)
    return ""


def test_the_core_refuses_tables_that_do_not_fit() -> None:
    assert refused(BOARD, {}) == ""
    assert "camera.rays" in refused(BOARD, {"camera.rays": np.zeros((61, 80, 4), np.int32)})
    assert "76 degrees" in refused(BOARD, {"camera.rays": np.full((61, 81, 4), 1 << 27, np.int32)})
    assert "camera.source" in refused(BOARD, {"camera.source": np.zeros((3, 3, 2), np.int32)})
    assert "camera.step_log2" in refused(BOARD, {}, **{"camera.step_log2": "9"})
    assert "camera.focal_mpx" in refused(BOARD, {}, **{"camera.focal_mpx": "0"})
