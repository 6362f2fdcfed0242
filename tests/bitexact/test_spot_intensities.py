"""The stage spot_intensities and the wrench of its features are the mirror's, bit for bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.feature_wrench import FeatureWrench
from mirror.fixed import Saturations
from mirror.light import rest_image
from mirror.spot_intensities import ONE, SpotIntensities, nominal_q8
from test_targets import tables

from ruffini.boards import Board, parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.core.pipeline import Features
from ruffini.errors import InputError

WIDTH, HEIGHT, N_REST, N_X, N_Y = 122, 91, 3, 5, 4
LOST, DARK, LIGHT = 8, 64, 1024  # FlagBit
Picture = npt.NDArray[np.uint8]
SCATTERED = [[2_000, 2_000], [9_500, 3_000], [6_000, 7_000], [3_000, 7_500], [10_500, 7_000], [5_500, 2_500]]


SMALL = """
schema = 1
[board]
name = "small"
product = "test"
not_measured = []
[camera]
optics = "test"
width_px = 122
height_px = 91
rate_mhz = 60000
focal_mpx = 61300
center_x_mpx = 60310
center_y_mpx = 45177
standoff_um = 6123
[pad]
size_x_um = 12001
size_y_um = 9003
thickness_um = 2000
modulus_pa = 200000
poisson_1e4 = 4800
[markers]
polarity = "light"
{layout}
pitch_x_um = 2000
pitch_y_um = 1990
first_x_um = 2010
first_y_um = 1500
diameter_um = 1100
threshold_1e3 = 200
max_lost = 1
[pipeline]
n_rest_frames = 3
stages = ["difference", "spot_intensities", "feature_wrench"]
"""


def board_text(places: list[list[int]] | None = None) -> str:
    if places is None:
        return SMALL.format(layout=f"n_x = {N_X}\nn_y = {N_Y}")
    return SMALL.format(layout=f'layout = "scattered"\nplaces_um = {places}\nn_x = {len(places) // 2}\nn_y = 2')


class Bundle:
    """Pictures of spots on black, a little off their nominal places."""

    def __init__(self, text: str) -> None:
        self.board = read_board(text)
        rng = np.random.default_rng(3)
        camera = self.board["camera"]
        self.radius = 1100 * camera["focal_mpx"] / camera["standoff_um"] / 2000
        self.at = np.array(nominal_q8(self.board)) / 256 + rng.uniform(-0.8, 0.8, (len(nominal_q8(self.board)), 2))
        self.level = rng.uniform(50, 90, len(self.at))
        self.rng = np.random.default_rng(5)

    def picture(self, change: npt.NDArray[np.float64] | float, noise: float = 1.0) -> Picture:
        y, x = np.mgrid[:HEIGHT, :WIDTH]
        light = np.full((HEIGHT, WIDTH), 1.5)
        for (u, v), level in zip(self.at, self.level * (1 + np.asarray(change)) * np.ones(len(self.at)), strict=True):
            light += level * np.clip(self.radius + 0.5 - np.hypot(x - u, y - v), 0, 1)
        colours = light[..., None] * [0.9, 1.0, 1.1] + self.rng.normal(0, noise, (HEIGHT, WIDTH, 3))
        return np.clip(np.round(colours), 0, 255).astype(np.uint8)

    def pressed(self, size: float) -> npt.NDArray[np.float64]:
        return np.asarray(size * np.exp(-((self.at - self.at[len(self.at) // 2]) ** 2).sum(axis=1) / 300))


def opened(text: str, n: int) -> tuple[Board, dict[str, npt.NDArray[np.generic]], Pipeline]:
    parsed = parse_board(text.encode(), "small")
    kind = tables(np.random.default_rng(7), n)
    return parsed, kind, Pipeline(parsed, pack(kind, {**base_metadata(parsed), "wrench.features": "spots"}).data)


def learned(core: Pipeline, bundle: Bundle, change: npt.NDArray[np.float64] | float = 0.0) -> SpotIntensities:
    at_rest = np.stack([bundle.picture(change) for _ in range(N_REST)])
    for frame in at_rest:
        core.process(frame)
    return SpotIntensities(bundle.board, rest_image(at_rest))


@pytest.mark.parametrize("places", [None, SCATTERED], ids=["lattice", "scattered"])
def test_features_and_wrench_are_those_of_the_mirror(places: list[list[int]] | None) -> None:
    text = board_text(places)
    bundle = Bundle(text)
    n = len(bundle.at)
    _, kind, core = opened(text, n)
    wrench, saturations, largest = FeatureWrench(kind), Saturations(), []
    with core:
        assert core.feature_sort() == Features("spots", n, None if places else (1, N_Y, N_X))
        assert core.slots["features"].unit == "1/65536 of rest"
        mirror = learned(core, bundle)
        for t, size in enumerate([0.0, 0.05, 0.4, 1.2, -0.5, *[0.01] * 20, 0.0]):
            # Lamps that drift, followed while nothing presses.
            frame = bundle.picture((1 + bundle.pressed(size if t < 5 else 0.0)) * (1 + (0.01 if t > 4 else 0.0)) - 1)
            said, seen = core.process(frame, capture_s=0.03 * t), mirror.run(frame)
            assert core.features().tolist() == seen.features.tolist(), t
            stated = wrench.run(seen.features.tolist(), round(30_000 * t) + (t == 0), saturations)
            assert said.wrench_un.tolist() == stated.wrench, t
            assert core.covariance().tolist() == stated.covariance
            assert not said.flags & (LOST | DARK)
            largest.append(np.abs(seen.features).max())
    assert max(largest) > 0.5 * ONE
    assert largest[3] > 20 * largest[0]


@pytest.fixture
def bundle() -> Bundle:
    return Bundle(board_text())


@pytest.fixture
def core(bundle: Bundle) -> Iterator[Pipeline]:
    with opened(board_text(), len(bundle.at))[2] as pipeline:
        yield pipeline


def test_lost_spots_are_filled_from_their_neighbours_and_flagged_beyond_max_lost(
    core: Pipeline, bundle: Bundle
) -> None:
    mirror = learned(core, bundle)
    for lost in ([7], [7, 8]):  # a broken fibre, and one that is too bright beside it
        change = bundle.pressed(0.6)
        change[lost[:1]] = -1.0
        change[lost[1:]] = 6.0
        frame = bundle.picture(change)
        said, seen = core.process(frame), mirror.run(frame)
        assert seen.n_lost == len(lost)
        assert core.features().tolist() == seen.features.tolist()
        assert bool(said.flags & LOST) == (len(lost) > 1)
        near = [i for i in mirror.near[7] if i not in lost]
        assert core.features()[7] == pytest.approx(core.features()[near].mean(), abs=1)


def test_a_spot_that_is_dark_at_rest_is_lost_from_the_start(core: Pipeline, bundle: Bundle) -> None:
    dark = np.zeros(len(bundle.at))
    dark[[3, 4]] = -0.95
    mirror = learned(core, bundle, dark)
    frame = bundle.picture(dark)
    said, seen = core.process(frame), mirror.run(frame)
    assert seen.n_lost == 2
    assert said.flags & LOST
    assert core.features().tolist() == seen.features.tolist()


def test_lamps_that_change_at_a_stroke_are_flagged_and_a_dark_picture_too(core: Pipeline, bundle: Bundle) -> None:
    learned(core, bundle)
    assert not core.process(bundle.picture(0.0)).flags & (LIGHT | DARK)
    assert core.process(bundle.picture(0.2, noise=0.3)).flags & LIGHT
    said = core.process(bundle.picture(-0.97))
    assert said.flags & DARK
    assert said.flags & LOST


def test_a_held_touch_is_never_learned(core: Pipeline, bundle: Bundle) -> None:
    learned(core, bundle)
    core.process(bundle.picture(bundle.pressed(0.1)))
    first = core.features()
    for _ in range(60):
        core.process(bundle.picture(bundle.pressed(0.1)))
    assert np.abs(core.features() - first).max() < 0.02 * ONE
    core.process(bundle.picture(0.0))
    assert abs(np.median(core.features())) < 0.005 * ONE


def test_lamps_that_change_under_a_touch_are_flagged(core: Pipeline, bundle: Bundle) -> None:
    mirror = learned(core, bundle)
    local = bundle.pressed(0.5) * (bundle.pressed(1.0) > 0.2)
    for lamp in (1.0, 0.9, 1.1):
        frame = bundle.picture((1 + local) * lamp - 1)
        said, seen = core.process(frame), mirror.run(frame)
        assert core.features().tolist() == seen.features.tolist()
        assert bool(said.flags & LIGHT) == seen.is_light_wrong == (lamp != 1.0)


def test_frames_that_hide_too_many_spots_are_not_followed(core: Pipeline, bundle: Bundle) -> None:
    learned(core, bundle)
    change = np.full(len(bundle.at), 6.0)
    change[0] = 0.035
    for _ in range(40):
        assert core.process(bundle.picture(change)).flags & LOST
    core.process(bundle.picture(0.0))
    assert np.abs(core.features()).max() < 0.01 * ONE


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [("places_um", "# places_um", "needs the spots' places"), ('"light"', '"dark"', "needs markers.polarity light")],
)
def test_a_board_on_which_nothing_is_seen_is_refused(old: str, new: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        parse_board(board_text(SCATTERED).replace(old, new, 1).encode(), "small")
