"""The twin's camera against geometry and light worked out by hand."""

import shutil

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.settings import load_twin

FOCAL_PX, CENTER_PX, STANDOFF_MM = 300.0, np.array([159.5, 119.5]), 20.0  # boards/gelslim/board.toml


def moved(unit, u_mm, slope=(0.0, 0.0)):
    """A displacement of the whole surface: a shift, and u_z growing along x and y by `slope`."""
    x, y = np.meshgrid(unit.model.node_x(), unit.model.node_y())
    u = np.tile(np.array(u_mm) * 1e-3, (x.size, 1)).astype(float)
    u[:, 2] += slope[0] * x.ravel() + slope[1] * y.ravel()
    return u


def dot_place_mm(unit, i, j):
    """Where the unit's printer put dot (i, j), from the pad's centre."""
    nominal = np.array([1.0 + i - 10, 1.0 + j - 8])
    turn = unit.twin.unit.lattice_turn_mrad * 1e-3
    nominal = nominal + np.array(unit.twin.unit.lattice_shift_um) * 1e-3
    return np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ nominal


def darkest_near(image, at_px):
    """Centroid of the darkening within 5 px of a pixel."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    near = np.hypot(u - at_px[0], v - at_px[1]) < 5
    dark = np.where(near, np.maximum(np.median(image[near]) * 0.8 - image, 0), 0)
    return np.array([(dark * u).sum(), (dark * v).sum()]) / dark.sum()


@pytest.mark.parametrize("u_mm", [(0, 0, 0), (0.2, -0.1, 0), (0, 0, -0.8), (0.1, 0.3, -0.5)])
def test_dots_are_where_a_pinhole_puts_them(coarse_unit, u_mm):
    image = coarse_unit.renderer().image(moved(coarse_unit, u_mm), np.random.default_rng(0)).mean(axis=2)
    for i, j in ((9, 7), (2, 3), (15, 12)):
        place = dot_place_mm(coarse_unit, i, j) + u_mm[:2]
        expected = CENTER_PX + FOCAL_PX * place / (STANDOFF_MM + u_mm[2])
        assert np.hypot(*(darkest_near(image, expected) - expected)) < 0.1


def test_depth_of_a_tilted_surface(coarse_unit):
    depth = coarse_unit.renderer().depth_mm(moved(coarse_unit, (0, 0, -0.4), slope=(0.03, -0.02)))
    v, u = np.mgrid[40:200:20, 40:280:20]
    ray_x, ray_y = (u - CENTER_PX[0]) / FOCAL_PX, (v - CENTER_PX[1]) / FOCAL_PX
    # z = -0.4 + 0.03 x - 0.02 y meets x = ray (20 + z)
    exact = (-0.4 + 20 * (0.03 * ray_x - 0.02 * ray_y)) / (1 - 0.03 * ray_x + 0.02 * ray_y)
    np.testing.assert_allclose(depth[40:200:20, 40:280:20], exact, atol=1e-3)


def test_untouched_pad_has_its_mean_level_and_nothing_is_full(coarse_unit):
    renderer = coarse_unit.renderer(has_dots=False)
    image = renderer.image(coarse_unit.at_rest(), np.random.default_rng(0))
    assert image.mean() == pytest.approx(coarse_unit.twin.light.mean_level, abs=0.3)
    assert image.max() < 255
    assert image.min() > 10


@pytest.mark.parametrize(("channel", "led"), [(0, "led_b_um"), (1, "led_g_um"), (2, "led_r_um")])
def test_surface_that_turns_to_a_light_gets_brighter(coarse_unit, channel, led):
    """The lit side faces the camera (-z): a slope dz/dx > 0 turns it towards +x."""
    place = np.array(getattr(coarse_unit.twin.light, led)[:2], dtype=float)
    slope = 0.05 * place / np.hypot(*place)
    renderer, rng = coarse_unit.renderer(), np.random.default_rng(0)
    middle = (slice(110, 130), slice(150, 170), channel)
    to_light = renderer.image(moved(coarse_unit, (0, 0, 0), slope), rng)[middle].mean()
    away = renderer.image(moved(coarse_unit, (0, 0, 0), -slope), rng)[middle].mean()
    assert to_light > away + 2


def test_noise_is_what_twin_toml_says(coarse_unit):
    renderer, rng = coarse_unit.renderer(), np.random.default_rng(5)
    frames = np.array([renderer.image(coarse_unit.at_rest(), rng) for _ in range(40)], dtype=float)
    noise = coarse_unit.twin.noise
    rounding = 1 / 12
    expected = (noise.read_1e3 * 1e-3) ** 2 + noise.shot_1e3 * 1e-3 * frames.mean(axis=0) + rounding
    assert frames.var(axis=0, ddof=1).mean() == pytest.approx(expected.mean(), rel=0.02)


def test_same_seed_same_picture(coarse_unit):
    renderer = coarse_unit.renderer()
    first, again, other = (renderer.image(coarse_unit.at_rest(), np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).any()


def copied_board(tmp_path, name="gelslim"):
    folder = tmp_path / name
    shutil.copytree(find_board(name).folder, folder)
    return folder


def test_board_without_twin_is_refused(tmp_path):
    folder = copied_board(tmp_path)
    (folder / "twin.toml").unlink()
    with pytest.raises(InputError, match="no optics to simulate"):
        load_twin(find_board(folder))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("blur_um = 60", "blurr_um = 60", "dots.blur"),
        ("blur_um = 60", "blur_um = 60.0", "dots.blur_um"),
        ("mean_level = 105", "mean_level = 900", "light.mean_level"),
        ("schema = 1", "schema = 2", "schema"),
        ("[noise]", "[noise", "not TOML"),
    ],
)
def test_bad_twin_toml_is_refused(tmp_path, old, new, words):
    folder = copied_board(tmp_path)
    text = (folder / "twin.toml").read_text()
    assert old in text
    (folder / "twin.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=words):
        load_twin(find_board(folder))
