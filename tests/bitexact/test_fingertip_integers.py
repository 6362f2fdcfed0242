"""The estimator of a fingertip against the mirror, bit for bit, on rendered dents; refusals and flags."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from mirror.fingertip import Fingertip

from ruffini.boards import find_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.fingertip.eyes import Eyes
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.settings import load_twin

BOARD = find_board(Path(__file__).parents[2] / "boards" / "stereo-fingertip")
MOST_UN, WIDTH_PX, BASELINE_MM = 1_300_000, 320, 10
MARKERS_LOST, OVER_RANGE, LIGHT, FEATURES, OTHER_PAD, VIEW_LOST = 8, 32, 1024, 2048, 4096, 16384
VALID, INVALID = 1, 3
WIDTHS = (11, 16, 13, 12, 14)  # of the smallest network: places, components, hidden, outputs


@cache
def dome() -> Renderer:
    return Renderer.over_chart(BOARD, load_twin(BOARD))


@cache
def frame(depth_um: int, a_mm: float, b_mm: float) -> npt.NDArray[np.uint8]:
    renderer = dome()
    a, b = np.meshgrid(renderer.node_a_mm, renderer.node_b_mm)
    down = -depth_um * 1e-6 * np.exp(-((a - a_mm) ** 2 + (b - b_mm) ** 2) / 40)
    moved = np.stack([0.2 * down, 0.1 * down, down], axis=-1).reshape(-1, 3)
    return renderer.image(moved, np.random.default_rng(depth_um))


@cache
def rest_markers() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.uint8]]:
    with Pipeline(BOARD) as path:
        learn(path)
        path.process(frame(0, 0, 0))
        rest, _, lost = path.markers()
    return rest, lost


def learn(path: Pipeline) -> None:
    for _ in range(BOARD.pipeline.n_rest_frames):
        path.process(frame(0, 0, 0))


@cache
def pairs() -> npt.NDArray[np.int64]:
    """Markers of both eyes that are one pin."""
    return Eyes.of(BOARD, BASELINE_MM).pairs(*rest_markers()[0])


def tensors(rng: np.random.Generator) -> dict[str, npt.NDArray[Any]]:
    """Tables of a plausible size; the pins are the unit's own, in any order."""
    rest, eyes = rest_markers()[0], Eyes.of(BOARD, BASELINE_MM)
    left, right = rng.permutation(pairs())[:280].T
    pins = np.stack([rest[0, left], rest[1, right]])
    flat = (pins[0] - [159.5, 119.5]) / 140
    normal = np.column_stack([flat, np.sqrt(1 - (flat**2).sum(axis=1))])
    gain = eyes.gains(eyes.place(pins)) * rng.uniform(0.8, 1.2, (280, 1, 1)) * 256_000
    spread = rng.uniform(-0.3, 0.3, (WIDTHS[0], 2))
    place = np.column_stack([spread, np.sqrt(1 - (spread**2).sum(axis=1))])
    n_features = 3 * WIDTHS[0] + 2
    widths = (n_features, *WIDTHS[1:])
    out: dict[str, npt.NDArray[Any]] = {
        "rest": pins * 256, "normal": normal * 2**14, "gain": gain,
        "place": place * 2**14, "kernel": 2**15 * np.exp(-np.arange(2048) / 500), "gate": np.array([768, 1600]),
        "mean": rng.normal(0, 2000, (3, n_features)), "near": rng.uniform(0, 2**12, (3, WIDTHS[1])),
        "length": rng.uniform(0, 2**12, (3, WIDTHS[1])), "limit": np.full((3, 2), 30_000),
        "zero": np.array([500_000, 1000, 0, 0, 0, 0, 9000]), "trust": rng.uniform(100, 900, (3, 7)),
        "scale": np.array([250_000, 600, 3000, 3000, 140_000, 140_000, 1500]),
    }  # fmt: skip
    for i in range(4):
        size = 2**12 * 0.8 if i == 0 else 2**16 / np.sqrt(widths[i])
        out[f"weight{i}"] = rng.normal(0, size, (3, widths[i + 1], widths[i]))
        if i:
            out[f"bias{i}"] = rng.normal(0, 2**15, (3, widths[i + 1]))
    out |= area_tables(rng)
    return {f"fingertip.{name}": np.round(v).astype(np.int32) for name, v in out.items()}


def area_tables(rng: np.random.Generator) -> dict[str, npt.NDArray[Any]]:
    """24 rays of half a millimetre on a dome of 22 mm, and a table that often tells a face."""
    angle, way = np.meshgrid(np.arange(24) * np.pi / 12, np.arange(21) / 44, indexing="ij")
    ray = np.stack([np.sin(way) * np.cos(angle), np.sin(way) * np.sin(angle), np.cos(way)], axis=-1)
    counts = [3, 2, 4, 3]
    face = np.stack([rng.uniform(3e4, 2e5, np.prod(counts)), rng.uniform(500, 20_000, np.prod(counts)),
                     rng.uniform(30_000, 65_536, np.prod(counts))], axis=1)  # fmt: skip
    steps = [[100_000, 400_000, 3], [-500, 1500, 2], [900, 800, 4], [700, 900, 3]]
    return {"ray": ray * 2**14, "cell": np.linspace(8e3, 1.4e6, 21), "tip": np.array([328_000]),
            "face_axis": np.array(steps), "face": face}  # fmt: skip


def quality(path: Pipeline) -> npt.NDArray[np.int64]:
    return path.marker_quality().astype(np.int64)


def opened(tables: dict[str, npt.NDArray[Any]]) -> Pipeline:
    meta = {**base_metadata(BOARD), "kinds": "fingertip", "fingertip.most_un": str(MOST_UN)}
    return Pipeline(BOARD, pack(tables, meta).data)


def mirror(tables: dict[str, npt.NDArray[Any]]) -> Fingertip:
    own = Fingertip(tables, MOST_UN)
    rest, lost = rest_markers()
    own.learn((rest * 65536).astype(np.int64), (lost == 2).astype(np.int64))
    return own


def hostile(rng: np.random.Generator) -> dict[str, npt.NDArray[Any]]:
    """Tables that no fit gives, each number as large as load() lets it be: nothing may overflow."""
    out = tensors(rng)
    out["fingertip.zero"][:], out["fingertip.scale"][:], out["fingertip.trust"][:] = 1 << 24, 1 << 24, 1 << 20
    out["fingertip.bias3"][:] = (1 << 26) * rng.choice([-1, 1], out["fingertip.bias3"].shape)
    out["fingertip.weight0"] = np.clip(out["fingertip.weight0"].astype(np.int64) << 14, -(1 << 26), 1 << 26).astype(
        np.int32
    )
    out["fingertip.length"][:], out["fingertip.limit"][:] = 1 << 20, 1 << 20
    return out


@pytest.mark.parametrize("make", [tensors, hostile])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_number_is_the_mirrors(seed: int, make: Callable[..., dict[str, npt.NDArray[Any]]]) -> None:
    tables = make(np.random.default_rng(seed))
    own, touched, flat, told = mirror(tables), 0, 0, 0
    with opened(tables) as path:
        learn(path)
        for depth, a, b in ((0, 0, 0), (150, 4, 1), (600, -9, 3), (1400, 2, -12), (2000, 14, 8)):
            for blind, eyes in ((None, 0), (1, 1), (0, 2)):
                picture = frame(depth, a, b).copy()
                if blind is not None:
                    picture[:, blind * WIDTH_PX : (blind + 1) * WIDTH_PX] = 0
                said = path.process(picture)
                moved = path.features().reshape(2, -1, 2)
                before = own.n_saturated
                row = own.run(moved, quality(path), eyes)
                assert list(path.tip()) == row
                assert bool(said.flags & VIEW_LOST) == (blind is not None)
                assert bool(said.flags & FEATURES) == (not row[1])
                assert bool(said.flags & OVER_RANGE) == (not row[2])
                assert said.n_contacts == row[0]
                is_unseen = blind is not None and not row[0]  # what one eye does not feel may be there
                is_held = own.n_saturated > before
                assert said.force_z_validity == (INVALID if is_unseen or is_held else VALID)
                touched += row[0]
                flat += row[17] > 0
                told += row[9] > 0 and blind is None
        assert own.n_saturated == said.saturations
        assert (own.n_saturated > 0) == (make is hostile)
    assert touched >= 9
    assert flat >= 3
    assert told >= 1 or make is hostile


def hide(picture: npt.NDArray[np.uint8], u: int, v: int, px: int = 11) -> None:
    """Skin over a pin, from the right."""
    picture[v - 5 : v + 6, u + 6 - px : u + 6] = picture[v - 5, u - 5]


def hide_half(picture: npt.NDArray[np.uint8], u: int, v: int) -> None:
    hide(picture, u, v, 6)


def scratch(picture: npt.NDArray[np.uint8], u: int, v: int) -> None:
    """A black line: the pin is found, and nobody can be sure where."""
    picture[v - 6 : v + 7, u : u + 3] = 0


def raise_it(picture: npt.NDArray[np.uint8], u: int, v: int) -> None:
    """A sharp pin, one pixel higher than the other eye can believe: two eyes side by side see the same height."""
    picture[v - 3 : v + 4, u - 3 : u + 4] = picture[v - 2 : v + 5, u - 3 : u + 4].copy()


def raise_half(picture: npt.NDArray[np.uint8], u: int, v: int) -> None:
    """By half a pixel."""
    was = picture[v - 3 : v + 4, u - 3 : u + 4].astype(np.uint16)
    raise_it(picture, u, v)
    picture[v - 3 : v + 4, u - 3 : u + 4] = (was + picture[v - 3 : v + 4, u - 3 : u + 4]) // 2


Spoil = Callable[[npt.NDArray[np.uint8], int, int], None]
SPOILT: dict[str, tuple[list[tuple[int, int, Spoil]], int | None, int, int]] = {
    # how many pins of which eye and how; the eye that is black; pins that the eyes contradict each other about; flags
    "half a pin": ([(0, 1, hide_half)], None, 0, 0),
    "a pin of each eye": ([(0, 1, hide), (1, 1, hide)], None, 0, 0),  # beside one at the edge that the press hides
    "four pins of one eye": ([(0, 4, hide)], None, 0, VIEW_LOST),
    "two pins of each eye": ([(0, 2, hide), (1, 2, hide)], None, 0, MARKERS_LOST),
    "two pins of an eye that sees alone": ([(0, 2, hide)], 1, 0, MARKERS_LOST | VIEW_LOST),
    "a scratch over two pins": ([(0, 2, scratch)], None, 0, 0),
    "a scratch over four pins": ([(0, 4, scratch)], None, 0, VIEW_LOST),
    "a pin that moved as none does": ([(1, 1, raise_it)], None, 1, 0),
    "a pin half a pixel off": ([(1, 1, raise_half)], None, 1, 0),
    "three pins that moved as none does": ([(1, 3, raise_it)], None, 3, MARKERS_LOST),
    "one such pin and two scratched": ([(1, 1, raise_it), (0, 2, scratch)], None, 1, MARKERS_LOST),
    "four such, beside a blind eye": ([(1, 4, raise_it), (0, 4, scratch)], None, 4, MARKERS_LOST | VIEW_LOST),
}  # fmt: skip
FIRST_PIN = {hide: 0, hide_half: 0, scratch: 20, raise_it: 75, raise_half: 75}  # others, so that no pin is spoilt twice


@pytest.mark.parametrize("case", SPOILT, ids=str)
def test_pins_that_are_seen_wrong_are_left_out(case: str) -> None:
    """An eye is not sure of them, or the other contradicts it."""
    how, black, n_contradicted, flags = SPOILT[case]
    tables = tensors(np.random.default_rng(1))
    own, picture = mirror(tables), frame(1400, 2, -12).copy()
    with opened(tables) as path:
        learn(path)
        path.process(picture)
        clean, (rest, moved, _) = list(path.tip()), path.markers()
        for eye, n, spoil in how:
            for pin in range(FIRST_PIN[spoil], FIRST_PIN[spoil] + 40 * n, 40):
                u, v = np.round((rest + moved)[eye, pin]).astype(int)
                spoil(picture, u, v)
        if black is not None:
            picture[:, black * WIDTH_PX : (black + 1) * WIDTH_PX] = 0
        said = path.process(picture)
        seen = path.features().reshape(2, -1, 2)
        eyes = 0 if not flags & VIEW_LOST else 1 if black == 1 else 2
        assert list(path.tip()) == own.run(seen, quality(path), eyes)
        assert own.n_contradicted == n_contradicted
        assert said.flags & (VIEW_LOST | MARKERS_LOST) == flags
        assert said.force_z_validity == (INVALID if flags & MARKERS_LOST else VALID)
        assert path.tip()[0]
        assert list(path.tip()) != clean


@pytest.mark.parametrize("eye", [0, 1])
def test_an_eye_that_is_dead_from_the_start_leaves_the_other(eye: int) -> None:
    """Even where the other one lacks a few pins at rest: it is no other pad, and no half of the markers is missing."""
    tables, touched = tensors(np.random.default_rng(1)), 0
    rest, lost = rest_markers()
    own = Fingertip(tables, MOST_UN)
    with opened(tables) as path:
        for depth, a, b in (*BOARD.pipeline.n_rest_frames * ((0, 0, 0),), (1400, 2, -12), (2000, 14, 8)):
            picture = frame(depth, a, b).copy()
            picture[:, eye * WIDTH_PX : (eye + 1) * WIDTH_PX] = 0
            picture[100:130, (1 - eye) * WIDTH_PX + 100 : (1 - eye) * WIDTH_PX + 130] = 0
            said = path.process(picture)
            if depth == 0:
                continue
            if depth == 1400:
                rest, _, lost = path.markers()
                own.learn((rest * 65536).astype(np.int64), (lost == 2).astype(np.int64))
            row = own.run(path.features().reshape(2, -1, 2), quality(path), 2 - eye)
            assert list(path.tip()) == row
            assert said.flags & (VIEW_LOST | OTHER_PAD | MARKERS_LOST) == VIEW_LOST
            assert said.force_z_validity == VALID
            touched += row[0]
    assert said.n_markers_at_rest < 292
    assert touched == 2


def test_two_eyes_that_are_dead_from_the_start_feel_nothing() -> None:
    with opened(tensors(np.random.default_rng(1))) as path:
        for _ in range(BOARD.pipeline.n_rest_frames + 1):
            said = path.process(np.zeros_like(frame(0, 0, 0)))
    assert said.flags & MARKERS_LOST
    assert said.force_z_validity == INVALID


@pytest.mark.parametrize(("limit", "is_known"), [((30_000, 30_000), True), ((1, 30_000), False), ((30_000, 1), False)])
def test_features_unlike_those_of_the_fit_are_flagged(limit: tuple[int, int], *, is_known: bool) -> None:
    tables = tensors(np.random.default_rng(7))
    tables["fingertip.length"][:], tables["fingertip.mean"][:], tables["fingertip.near"][:] = 1, 0, 1 << 18
    tables["fingertip.limit"][:] = limit
    with opened(tables) as path:
        learn(path)
        said = path.process(frame(1400, 2, -12))
        assert said.n_contacts == 1
        assert bool(said.flags & FEATURES) == (not is_known)
        assert path.tip().is_known == is_known
        assert not path.process(frame(0, 0, 0)).flags & FEATURES


@pytest.mark.parametrize(("offset", "is_off"), [(26, True), (-20, True), (4, False)])
def test_a_mean_level_off_by_a_quarter_is_flagged_on_a_live_camera(offset: int, *, is_off: bool) -> None:
    with opened(tensors(np.random.default_rng(7))) as path:
        path.set_live()
        for i in range(BOARD.pipeline.n_rest_frames + 1):
            path.process(noisy(i, 0))
        assert not path.process(noisy(99, 0)).flags & LIGHT
        assert bool(path.process(noisy(100, offset)).flags & LIGHT) == is_off


def noisy(seed: int, offset: int) -> npt.NDArray[np.uint8]:
    """The untouched tip with noise of its own, and a black level."""
    picture = frame(0, 0, 0) + np.random.default_rng(seed).normal(offset, 1.5, frame(0, 0, 0).shape)
    return np.clip(np.round(picture), 0, 255).astype(np.uint8)


def test_a_camera_that_moved_is_flagged() -> None:
    still = frame(0, 0, 0)
    with opened(tensors(np.random.default_rng(7))) as path:
        learn(path)
        assert not path.process(still).flags & FEATURES
        assert path.process(np.roll(still, 2, axis=1)).flags & FEATURES  # no load moves the rim so far


def test_pins_of_another_fingertip_are_another_pad() -> None:
    tables = tensors(np.random.default_rng(4))
    tables["fingertip.rest"] = tables["fingertip.rest"] + np.int32(1400)
    with opened(tables) as path:
        learn(path)
        said = path.process(frame(1400, 2, -12))
    assert said.flags & OTHER_PAD
    assert said.force_z_validity == 3


@pytest.mark.parametrize(
    ("name", "value", "says"),
    [
        ("fingertip.normal", 1 << 15, "range"),
        ("fingertip.gain", 1 << 25, "range"),
        ("fingertip.kernel", -1, "range"),
        ("fingertip.weight2", 1 << 27, "weight2"),
        ("fingertip.scale", 0, "scale"),
        ("fingertip.length", (1 << 20) + 1, "length"),
        ("fingertip.limit", (1 << 20) + 1, "limit"),
        ("fingertip.ray", (1 << 14) + 1, "ray"),
        ("fingertip.cell", 0, "cell"),
        ("fingertip.face", -1, "face"),
    ],
)
def test_tables_out_of_range_are_refused(name: str, value: int, says: str) -> None:
    tables = tensors(np.random.default_rng(5))
    tables[name].flat[0] = value
    with pytest.raises(InputError, match=says):
        opened(tables)


@pytest.mark.parametrize(
    "name", ["rest", "gain", "weight3", "bias1", "near", "trust", "limit", "cell", "tip", "face_axis", "face"]
)
def test_a_table_that_is_missing_or_misshapen_is_refused(name: str) -> None:
    for spoil in (lambda v: None, lambda v: v[..., :-1]):
        tables = tensors(np.random.default_rng(6))
        spoilt = spoil(tables.pop(f"fingertip.{name}"))
        if spoilt is not None:
            tables[f"fingertip.{name}"] = np.ascontiguousarray(spoilt)
        with pytest.raises(InputError):
            opened(tables)
