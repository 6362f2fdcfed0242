"""cal camera --views on pictures by the twin's own views: points in space come back through the core's integers."""

from __future__ import annotations

import itertools
import json
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from typer.testing import CliRunner

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.cli.app import app
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.camera.targets import Target
from ruffini.estimators.camera.views import fit_views, tables, view_kinds
from ruffini.sim.optics.camera import View, rotation
from ruffini.sim.optics.settings import LensSettings, MirrorSettings, ViewSettings

Array = npt.NDArray[np.float64]
Picture = npt.NDArray[np.uint8]

BOARD = find_board(Path(__file__).parents[3] / "boards" / "stereo-fingertip")  # 2 views of 320 x 240, 60 mm away
LENS = LensSettings(model="radtan", coefficients_1e6=[-120_000, 40_000, 1_000, -1_000, 0])
TARGET, PITCH_MM = Target("chessboard", 9, 6, 4.5), 4.5
STEREO = [View(BOARD, ViewSettings(offset_um=[5000 * side, 0, 0]), LENS, 2) for side in (-1, 1)]
# The second view goes over a mirror at x = 12 mm: its pinhole's image stands at x = 24 mm, looks at the pad's centre.
MIRRORED = [
    View(BOARD, ViewSettings(), LENS, 2),
    View(
        BOARD,
        ViewSettings(
            turn_mrad=[0, 381, 0], mirror=MirrorSettings(point_um=[12_000, 0, 0], normal_1e3=[1000, 0, 0])
        ),
        LENS, 2,
    ),
]  # fmt: skip
SIDES = list(itertools.product((-1, 1), (-1, 1)))
POSES = [
    *(((0.35 * y, -0.35 * x, 0.1), 64, (4 * x, 3 * y)) for x, y in SIDES),
    *(((-0.3 * y, 0.3 * x, -0.1), 70, (2 * x, 2 * y)) for x, y in SIDES),
    ((0.4, 0, 0), 75, (0, 0)),
    ((0, 0.4, 0), 75, (0, 0)),
]
FLAT = ((0, 0, 0), 60, (0.0, 0.0))


def picture(views: list[View], pose: tuple[tuple[float, ...], float, tuple[float, float]], seed: int) -> Picture:
    """What both views see of a chessboard at a pose: turn (rad), distance (mm), sideways (mm)."""
    turn, away_mm, beside_mm = pose
    axes, middle = rotation(np.array(turn)), np.array([*beside_mm, away_mm - 60.0])
    rng, parts = np.random.default_rng(seed), []
    for view in views:
        origin, ray = view.rays()
        along = ((middle - origin) @ axes[:, 2]) / (ray @ axes[:, 2])
        place = ((origin + along[..., None] * ray - middle) @ axes)[..., :2]
        u, v = place[..., 0] / PITCH_MM + 4, place[..., 1] / PITCH_MM + 2.5
        inside = (u > -1) & (u < 9) & (v > -1) & (v < 6)
        level = np.where(inside, 120 - 80 * np.tanh(6 * np.sin(np.pi * u) * np.sin(np.pi * v)), 200)
        parts.append(cv2.GaussianBlur(level, (0, 0), 0.6) + rng.normal(0, 1.5, level.shape))
    return np.repeat(np.clip(np.hstack(parts), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def write_pictures(views: list[View], folder: Path) -> list[Path]:
    """The poses, and last the one that lies on the pad."""
    paths = []
    for i, pose in enumerate([*POSES, FLAT]):
        paths.append(folder / f"{i:02d}.png")
        cv2.imwrite(str(paths[-1]), picture(views, pose, i))
    return paths


def points_mm() -> Array:
    """On the dome, and above it."""
    x, y, z = np.meshgrid(np.linspace(-12, 12, 6), np.linspace(-10, 10, 5), [-12.0, -6.0, 0.0, 1.5], indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)


@pytest.fixture(scope="module")
def stereo_paths(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_pictures(STEREO, tmp_path_factory.mktemp("stereo"))


@pytest.mark.parametrize(("views", "kinds"), [(STEREO, "straight,straight"), (MIRRORED, "straight,mirrored")])
def test_points_come_back(views: list[View], kinds: str, stereo_paths: list[Path], tmp_path: Path) -> None:
    paths = stereo_paths if views is STEREO else write_pictures(views, tmp_path)
    fit = fit_views(paths[:-1], TARGET, BOARD, view_kinds(kinds), is_fisheye=False, on_pad=paths[-1], index=1.0)
    report = fit.report()
    assert [view["kind"] for view in report["views"]] == kinds.split(",")
    assert all(0.005 < view["residual_px"] < 0.12 for view in report["views"])
    assert report["height_um"] < 120
    assert report["gap_um"] < 45  # 0.2 px
    tensors, metadata = tables(fit, BOARD)
    file = container.pack({**tensors}, {**container.base_metadata(BOARD), **metadata})
    truth = points_mm()
    places = [view.project(truth)[0] + [320 * i, 0] for i, view in enumerate(views)]
    inside = np.logical_and.reduce(
        [(p >= [320 * i, 0]).all(axis=1) & (p <= [320 * i + 319, 239]).all(axis=1) for i, p in enumerate(places)]
    )
    assert inside.sum() > 40
    with Pipeline(BOARD, file.data) as pipeline:
        found_m, gap_m = pipeline.triangulate(*(p[inside] for p in places))
    # What looking at the pad's centre leaves open: a shift along the pad, and a small turn.
    a, b = found_m * 1e3, truth[inside]
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    turn = left @ right
    assert np.abs(turn - np.eye(3)).max() < 0.03
    off = np.abs(a @ turn - b)
    assert np.sqrt((off[:, :2] ** 2).sum(axis=1).mean()) < 0.1  # half a pixel
    assert np.sqrt((off[:, 2] ** 2).mean()) < 0.15
    assert np.abs(found_m[:, 2] * 1e3 - truth[inside, 2]).mean() < 0.3
    assert gap_m.max() < 60e-6


def given(rays: npt.NDArray[np.int32], board: Board = BOARD, step_log2: str = "4") -> bytes:
    base = {**container.base_metadata(board), "views.step_log2": step_log2}
    return container.pack({"views.rays": rays}, base).data


def ray_lattice(a_um: tuple[float, float], slope: tuple[float, float]) -> npt.NDArray[np.int32]:
    """The same ray everywhere, 16 px apart."""
    ray = np.round([*(256 * v for v in a_um), *(2**20 * v for v in slope)]).astype(np.int32)
    return np.broadcast_to(ray, (16, 21, 4))


@pytest.mark.parametrize("seed", range(3))
def test_the_core_meets_rays_as_real_numbers_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    for _ in range(20):
        s1, s2 = rng.uniform(-1, 1, (2, 2))
        z_um, gap = rng.uniform(-30_000, 30_000), rng.uniform(-40, 40)
        across = np.array([s2[1] - s1[1], s1[0] - s2[0]]) / np.linalg.norm(s2 - s1)
        point = rng.uniform(-20_000, 20_000, 2)
        a1, a2 = point - s1 * z_um + across * gap / 2, point - s2 * z_um - across * gap / 2
        rays = np.stack([ray_lattice(tuple(a1), tuple(s1)), ray_lattice(tuple(a2), tuple(s2))])
        with Pipeline(BOARD, given(rays)) as pipeline:
            found, apart = pipeline.triangulate(np.array([[5.0, 5.0]]), np.array([[400.0, 30.0]]))
        slack_um = 0.02 + 0.05 / np.linalg.norm(s2 - s1)
        assert found[0, 2] * 1e6 == pytest.approx(z_um, abs=slack_um)
        np.testing.assert_allclose(found[0, :2] * 1e6, point, atol=2 * slack_um)
        assert apart[0] * 1e6 == pytest.approx(np.abs(across * gap).max(), abs=4 * slack_um)


def test_rays_that_do_not_meet() -> None:
    for slope in ((0.1, 0.2), (0.1001, 0.2)):
        rays = np.stack([ray_lattice((0, 0), (0.1, 0.2)), ray_lattice((900_000, 0), slope)])
        with Pipeline(BOARD, given(rays)) as pipeline:
            found, gap = pipeline.triangulate(np.array([[5.0, 5.0]]), np.array([[400.0, 30.0]]))
        assert np.isnan(found).all()
        assert np.isnan(gap).all()


def test_tables_that_do_not_fit_are_refused() -> None:
    sound = np.stack([ray_lattice((0, 0), (0.1, 0)), ray_lattice((0, 0), (-0.1, 0))])
    Pipeline(BOARD, given(sound)).close()
    for rays, said in (
        (sound[:1], "width"),
        (sound[:, :5], "shape"),
        (sound[0], "not there"),
        (np.full_like(sound, 1 << 29), "76 degrees"),
    ):
        with pytest.raises(InputError, match=said):
            Pipeline(BOARD, given(np.ascontiguousarray(rays)))
    with Pipeline(BOARD) as pipeline, pytest.raises(InputError, match="no views"):
        pipeline.triangulate(np.zeros((1, 2)), np.zeros((1, 2)))


def test_what_cannot_be_fitted(stereo_paths: list[Path], tmp_path: Path) -> None:
    paths = stereo_paths
    more = {"is_fisheye": False, "on_pad": paths[-1], "index": 1.0}
    with pytest.raises(InputError, match="straight first"):
        view_kinds("mirrored,straight")
    with pytest.raises(InputError, match="2 to 4"):
        view_kinds("straight")
    with pytest.raises(InputError, match="seen in 3 pictures by view 1 of 2"):
        fit_views(paths[:3], TARGET, BOARD, ["straight"] * 2, **more)
    with pytest.raises(InputError, match="3 views do not share the 640 px"):
        fit_views(paths[:-1], TARGET, BOARD, ["straight"] * 3, **more)
    half = cv2.imread(str(paths[-1]))
    half[:, 320:] = 90
    cv2.imwrite(str(tmp_path / "half.png"), half)
    with pytest.raises(InputError, match=r"half\.png: no chessboard found by view 2"):
        fit_views(paths[:-1], TARGET, BOARD, ["straight"] * 2, **{**more, "on_pad": tmp_path / "half.png"})


def test_the_verb(stereo_paths: list[Path], tmp_path: Path) -> None:
    paths, out = stereo_paths, tmp_path / "views.safetensors"
    words = [
        "cal",
        "fit",
        "--only",
        "camera",
        *map(str, paths[:-1]),
        "--board",
        str(BOARD.folder),
        "--target",
        "chessboard",
    ]
    words += ["--size", "9x6", "--pitch-mm", str(PITCH_MM), "--views", "straight,straight", "--out", str(out)]
    refused = CliRunner().invoke(app, words)
    assert "--on-pad" in str(refused.exception)
    done = CliRunner().invoke(app, [*words, "--on-pad", str(paths[-1]), "--json"])
    assert done.exit_code == 0, done.output
    assert json.loads(done.stdout)["height_um"] < 120
    assert container.read(out).kinds == ["views"]
