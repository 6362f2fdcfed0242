"""The whole path of the core against the mirror over a small recording, every stage's output bit for bit."""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept
from mirror.board import Board, read_board
from mirror.estimators import reaches_border
from mirror.field_repair import repaired_nodes
from mirror.path import FramePath
from odd_boards import small_board
from test_stages import render

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.operator.fit import make_operator
from ruffini.estimators.relaxation.fit import RelaxationFit
from ruffini.fem.operators import Noise

ALL_STAGES = (
    '["difference", "markers", "photometric", "poisson", "displacement", "operator", "support", "wrench", "contacts"]'
)
N_REST = 3
NOISE_UN = (700, 900)  # below the board's threshold, of 2 x 2 nodes and of one alone
VALID, UNCALIBRATED_Z, WINDOW_BORDER, LIGHT, FEATURES = 1, 4, 512, 1024, 2048  # of Validity and FlagBit


def board_with_all_stages(step: int, gauge: str = "margin") -> str:
    text = small_board(width=66, height=44, step=step, gauge=gauge)
    return text[: text.index("stages = ")] + f"stages = {ALL_STAGES}\n"


def photometric_tables(rng: np.random.Generator) -> dict[str, npt.NDArray[np.generic]]:
    """Blue tells slopes along x and green along y, half a slope each (`dent` shades so), roughly."""
    axis = np.linspace(-1, 1, 65)
    q_y, q_x = np.meshgrid(axis, axis, indexing="ij")
    slope = np.stack([q_x, q_y], axis=2) / np.sqrt(1.1 - 0.4 * (q_x**2 + q_y**2))[..., None]
    unmix = rng.integers(-300, 300, (4, 5, 2, 3))
    unmix[..., 0, 0] += 8192
    unmix[..., 1, 1] += 8192
    return {
        "photometric.unmix": unmix.astype(np.int16),
        "photometric.slope": np.round(slope * 4096).astype(np.int16),
    }


def camera_tables(board: Board, rng: np.random.Generator) -> tuple[dict[str, npt.NDArray[np.generic]], dict[str, str]]:
    """Rays of a lens of its own for every lattice point, and places all over the image and a little beyond."""
    camera, shift = board["camera"], 2
    width, height, step = camera["width_px"], camera["height_px"], board["depth"]["step_px"]
    lines = [np.arange(((n - 2) >> shift) + 2) * (1 << shift) for n in (width, height)]
    x, y = np.meshgrid(*(line - n / 2 for line, n in zip(lines, (width, height), strict=True)))
    bent = 1 + 1e-5 * (x**2 + y**2)
    um_per_px = camera["standoff_um"] * 1000 / camera["focal_mpx"]
    rays = np.stack([x * bent * um_per_px * 256, y * bent * um_per_px * 256, x * 9000, y * 8000], axis=-1)
    rays += rng.integers(-20, 20, rays.shape)
    u, v = np.meshgrid(np.arange(width // step) * step, np.arange(height // step) * step)
    source = np.stack([u * 1.1 - 3, v * 1.1 - 2], axis=-1) * 65536 + rng.integers(-40000, 40000, (*u.shape, 2))
    metadata = {"camera.step_log2": str(shift), "camera.focal_mpx": str(camera["focal_mpx"] * 14 // 10),
                "camera.standoff_um": str(camera["standoff_um"] * 14 // 10)}  # fmt: skip
    return {"camera.rays": rays.astype(np.int32), "camera.source": source.astype(np.int32)}, metadata


def dent(board: Board, t: int) -> npt.NDArray[np.float64]:
    """Coloured shading, relative change per channel, of a dent of 6 px that deepens and moves out of the window."""
    height, width = board["camera"]["height_px"], board["camera"]["width_px"]
    y, x = np.mgrid[:height, :width]
    along_x, along_y = x - width * 0.45 - 3 * t, y - height * 0.5 + 0.5 * t
    steepness = 0.016 * t * np.exp(-(along_x**2 + along_y**2) / 72.0)
    blue, green = 0.5 * along_x * steepness, 0.5 * along_y * steepness
    return np.stack([blue, green, -(blue + green) / 2], axis=2)


@pytest.mark.parametrize(
    ("step", "has_camera_map", "gauge"),
    [(1, False, "margin"), (2, False, "both"), (1, True, "margin"), (2, True, "margin")],
)
def test_every_stage_over_a_recording(step: int, has_camera_map: bool, gauge: str) -> None:
    text = board_with_all_stages(step, gauge)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(step)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)), is_finite=step == 2)
    memory = RelaxationFit(1.0, ((0.1, 0.05), (0.15, 1.5)), 0.0, 0.0)
    relaxation, relaxation_metadata = memory.tensors() if step == 2 else ({}, {})
    camera, camera_metadata = camera_tables(board, rng) if has_camera_map else ({}, {})
    noise = {} if has_camera_map else {"contact.noise_un": np.array(NOISE_UN, np.int32)}
    shape = (board["camera"]["height_px"], board["camera"]["width_px"], 3)
    dark = {"dark.image": rng.integers(0, 16 * 60, shape).astype(np.uint16)} if has_camera_map else {}
    file = pack(
        {**kind.tensors, **photometric_tables(rng), **relaxation, **camera, **noise, **dark},
        {**base_metadata(typed), **kind.metadata, **relaxation_metadata, **camera_metadata},
    )
    rest = np.stack([render(board, np.random.default_rng(7), 0.0) for _ in range(N_REST)])
    mirror = FramePath(board, file.tensors, file.metadata)
    n_touched = n_at_border = 0
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            assert not core.process(frame).has_reference
        n_found = mirror.learn(rest)
        assert n_found == board["markers"]["n_x"] * board["markers"]["n_y"]
        for t in range(10):
            moved = render(board, np.random.default_rng(100 + t), 0.05 * t) * (1 + dent(board, t))
            frame = np.clip(np.round(moved), 0, 255).astype(np.uint8)
            capture_s = 0.0137 * t**1.5
            result = core.process(frame, capture_s)
            expected = mirror.process(frame, 1 + round(capture_s * 1e6))
            assert result.n_markers_at_rest == n_found
            for name in ("change", "slope", "depth"):
                assert np.array_equal(core.raw(name), getattr(expected, name)), name
            nodes = expected.mask.shape
            assert np.array_equal(core.raw("mask"), expected.mask)
            assert np.array_equal(core.raw("displacement").reshape(*nodes, 3), expected.displacement)
            assert np.array_equal(core.raw("force").reshape(-1, 3), expected.force)
            assert result.wrench_un.tolist() == expected.wrench
            assert result.n_contacts == len(expected.contact_areas)
            is_valid = result.force_z_validity == VALID
            assert bool(result.flags & WINDOW_BORDER) == (is_valid and reaches_border(board, expected.force))
            assert result.saturations == mirror.saturations.count
            assert np.array_equal(core.residual().reshape(-1, 3), mirror.residual())
            n_touched += int(expected.mask.any())
            n_at_border += bool(result.flags & WINDOW_BORDER)
    assert 3 <= n_touched < 10, n_touched  # the recording has both: touched and untouched frames
    assert 0 < n_at_border < n_touched, n_at_border  # the dent walks over the window's border


# Noise (uN of four nodes, of one), and how far dots spread by themselves and how deep the dent is in each frame. In the
# second row many frames have forces, but none of a quarter of the board's threshold: no node presses.
PRESSES = [
    (NOISE_UN, [(0.1 * t, 1.0) for t in range(10)] + [(0.03 * t, 0.0) for t in range(1, 21)]),
    ((300, 400), [(0.02 * (t % 6), 0.05 * (t % 7)) for t in range(30)]),
]


@pytest.mark.parametrize(("noise_un", "presses"), PRESSES, ids=["pressed", "faint"])
def test_what_no_force_explains_is_flagged(noise_un: tuple[int, int], presses: list[tuple[float, float]]) -> None:
    """On a board that is seen whole: dents, dots that spread by themselves, and a pad that is pressed all over."""
    text = board_with_all_stages(2)
    for key, value in (("min_x_um", 0), ("max_x_um", 4001), ("max_y_um", 3003)):
        text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(3)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-7, 5e-7, 2e-6)))
    assert "support.spread" in kind.tensors
    noise = {"contact.noise_un": np.array(noise_un, np.int32)}
    file = pack({**kind.tensors, **photometric_tables(rng), **noise}, {**base_metadata(typed), **kind.metadata})
    rest = np.stack([render(board, np.random.default_rng(7), 0.0) for _ in range(N_REST)])
    mirror = FramePath(board, file.tensors, file.metadata)
    said: dict[bool, list[bool]] = {}
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            core.process(frame)
        mirror.learn(rest)
        for t, (spread, dented) in enumerate(presses):
            moved = render(board, np.random.default_rng(100 + t), spread)
            frame = np.clip(np.round(moved * (1 + dented * dent(board, t % 5))), 0, 255).astype(np.uint8)
            is_unexplained = bool(core.process(frame).flags & FEATURES)
            expected = mirror.process(frame, 0)
            assert np.array_equal(core.raw("force").reshape(-1, 3), expected.force)
            assert is_unexplained == (not mirror.is_explained), t
            said.setdefault(bool(expected.force.any()), []).append(is_unexplained)
    assert True in said
    for has_force, flags in said.items():
        assert 0 < sum(flags) < len(flags), (has_force, flags)


def test_a_gauge_without_its_table_measures_no_depth() -> None:
    text = board_with_all_stages(2, "both")
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)))
    tables = {k: v for k, v in kind.tensors.items() if k != "gauge.weight"}
    file = pack({**tables, **photometric_tables(np.random.default_rng(1))}, {**base_metadata(typed), **kind.metadata})
    with Pipeline(typed, file.data) as core:
        for seed in range(N_REST + 1):
            frame = np.clip(np.round(render(board, np.random.default_rng(seed), 0.0)), 0, 255).astype(np.uint8)
            result = core.process(frame)
        assert not core.raw("displacement")[..., 2].any()
    assert result.flags & UNCALIBRATED_Z
    assert result.force_z_validity != VALID


def test_drifting_light_is_followed_while_nothing_touches() -> None:
    text = board_with_all_stages(2)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(3)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)))
    noise = {"contact.noise_un": np.array(NOISE_UN, np.int32)}
    noise["dark.image"] = np.full((board["camera"]["height_px"], board["camera"]["width_px"], 3), 300, np.uint16)
    file = pack({**kind.tensors, **photometric_tables(rng), **noise}, {**base_metadata(typed), **kind.metadata})
    mirror = FramePath(board, file.tensors, file.metadata)
    rest = np.stack([render(board, rng, 0.0) for _ in range(N_REST)])
    n_off, gains = 0, []
    n_unsteady = 0
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            core.process(frame)
        mirror.learn(rest)
        for t in range(180):
            light = 1 + np.array([0.0004, -0.0003, 0.0002]) * min(t, 100) + (0.08 if 60 <= t < 64 else 0)
            touch = dent(board, 8) if 70 <= t < 80 else np.zeros(rest[0].shape)
            daylight = 0.06 * (90 <= t < 94) * np.linspace(0, 1, rest.shape[1])[:, None, None]
            moved = render(board, rng, 0.6 if touch.any() else 0.0) * (light + daylight) * (1 + touch)
            frame = np.clip(np.round(moved), 0, 255).astype(np.uint8)
            result, expected = core.process(frame), mirror.process(frame, 1)
            assert np.array_equal(core.raw("change"), expected.change), t
            is_lit = mirror.light.is_lit_from_outside or mirror.light.is_lit_from_one_side
            assert bool(result.flags & LIGHT) == (mirror.light.is_off or is_lit), t
            assert np.array_equal(core.raw("mask"), expected.mask), t
            assert mirror.light.is_lit_from_one_side == (90 <= t < 94), t
            n_unsteady += not mirror.is_light_steady
            n_off += mirror.light.is_off
            gains.append(mirror.light.gain.copy())
    assert np.array_equal(gains[70], gains[79])  # the contact is not learned
    assert 3 <= n_off < 20, n_off  # the step is said
    assert np.allclose(mirror.light.gain / (1 << 20), light, atol=0.005)  # of 4 %
    assert 10 < n_unsteady < 170, n_unsteady


def test_a_balanced_table_takes_the_light_of_every_frame_off() -> None:
    text = board_with_all_stages(2)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(8)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)))
    bend = rng.integers(-2000, 2000, (9, 9, 9, 2)).astype(np.int16)
    bend[4, 4, 4] = 0
    tables = {
        **kind.tensors, **photometric_tables(rng),
        "photometric.bend": bend, "photometric.bend_axis": np.array([[-2048] * 3, [9, 9, 9]], np.int32),
        "photometric.balance": np.array([1], np.int32),
    }  # fmt: skip
    file = pack(tables, {**base_metadata(typed), **kind.metadata})
    mirror = FramePath(board, file.tensors, file.metadata)
    rest = np.stack([render(board, rng, 0.0) for _ in range(N_REST)])
    n_unsure = 0
    with Pipeline(typed, file.data) as core:
        for frame in rest:
            core.process(frame)
        mirror.learn(rest)
        for t in range(12):
            light = 1 + rng.uniform(-0.2, 0.2, 3) * (t < 10) + 0.4 * (t >= 10)
            touch = dent(board, 8) if t % 2 else np.zeros(rest[0].shape)
            frame = np.clip(np.round(render(board, rng, 0.4) * light * (1 + touch)), 0, 255).astype(np.uint8)
            result, expected = core.process(frame), mirror.process(frame, 1)
            assert np.array_equal(core.raw("slope"), expected.slope), t
            is_said = mirror.light.is_lit_from_outside or mirror.light.is_lit_from_one_side
            is_said |= not mirror.light.level_is_sure
            assert bool(result.flags & LIGHT) == is_said, t
            n_unsure += not mirror.light.level_is_sure
    assert 2 <= n_unsure < 6, n_unsure  # the last two frames are brighter than any camera's balance


@pytest.mark.parametrize("is_finite", [False, True])
def test_solve_on_random_displacements(is_finite: bool) -> None:
    text = board_with_all_stages(2)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(11)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)), is_finite=is_finite)
    tables = {**kind.tensors, **photometric_tables(rng)}
    file = pack(tables, {**base_metadata(typed), **kind.metadata})
    mirror = FramePath(board, file.tensors, file.metadata)
    with Pipeline(typed, file.data) as core:
        n = core.layout.node_n_x * core.layout.node_n_y
        for limit in (40, 400, 4000, 32767):
            u = rng.integers(-limit, limit + 1, (6, n, 3)).astype(np.int16)
            forces = core.solve(u)
            for one_u, force in zip(u, forces, strict=True):
                expected, _ = mirror.solve_given(one_u.astype(np.int64))
                assert np.array_equal(force, expected)


def test_wrong_and_missing_nodes_are_filled() -> None:
    """A smooth dent of which some nodes are off and some not measured: the mirror's integers, near the dent."""
    # The operator of test_stated_uncertainty.
    text = board_with_all_stages(2).replace("n_x = 9\nn_y = 7", "n_x = 29\nn_y = 22")
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-5, 5e-5, 2e-4)))
    file = pack(
        {**kind.tensors, **photometric_tables(np.random.default_rng(3))}, {**base_metadata(typed), **kind.metadata}
    )
    rng = np.random.default_rng(12)
    n_filled = 0
    with Pipeline(typed, file.data) as core:
        shape = (core.layout.node_n_y, core.layout.node_n_x)
        y, x = np.mgrid[: shape[0], : shape[1]]
        far2 = ((y - shape[0] * 0.45) ** 2 + (x - shape[1] * 0.55) ** 2) / 40
        smooth = np.stack([900 * (x - shape[1] / 2) / 9, 700 * (y - shape[0] / 2) / 9, 0 * x - 3000], axis=-1)
        smooth = np.round(smooth * np.exp(-far2)[..., None]).astype(np.int16)
        corners = [0, shape[1] - 1, -shape[1], -1]  # have too few nodes beside them to be known as wrong
        may_be_wrong = np.delete(np.arange(shape[0] * shape[1]), corners)
        for t in range(4):
            u = smooth.copy()
            wrong = rng.permutation(may_be_wrong)[:6]
            u.reshape(-1, 3)[wrong, t % 3] += 1600  # 0.2 mm
            if t % 2:
                u[shape[0] // 2 - 1 : shape[0] // 2 + 2, shape[1] // 2 : shape[1] // 2 + 3, t % 3] = -32768
            core.solve(u.reshape(1, -1, 3))
            expected, filled = repaired_nodes(board, u.astype(np.int64))
            assert np.array_equal(core.raw("displacement").reshape(-1, 3), expected)
            assert np.abs(core.raw("displacement") - smooth).max() < 240  # 30 um
            n_filled += int((filled > 0).sum())
        u = smooth.copy()
        u.reshape(-1, 3)[corners] += 1600
        core.solve(u.reshape(1, -1, 3))
        assert np.array_equal(core.raw("displacement").reshape(-1, 3), repaired_nodes(board, u.astype(np.int64))[0])
        u = np.full((1, shape[0] * shape[1], 3), -32768, np.int16)
        assert not core.solve(u).any()
        assert not core.raw("displacement").any()
    assert n_filled >= 24 + 2 * 9 - 6


def test_a_calibration_beyond_the_boards_memory_is_neither_made_nor_taken() -> None:
    text = board_with_all_stages(2)
    typed, small = (parse_board(t.encode(), "small") for t in (text, text + "[memory]\ncalibration_kb = 64\n"))
    noise = Noise((5e-6, 5e-6, 2e-5))
    kind = kept(make_operator, typed, method="support", noise=noise)
    with pytest.raises(InputError, match="the board has for it"):
        kept(make_operator, small, method="support", noise=noise)
    file = pack(kind.tensors, {**base_metadata(typed), **kind.metadata})
    assert len(file.data) > 64 * 1024
    with pytest.raises(InputError, match="64 kB"), Pipeline(small, file.data):
        pass


@pytest.mark.parametrize("seed", range(4))
def test_second_pass_with_hostile_tables_never_overflows(seed: int) -> None:
    """Whatever the loader lets through: the mirror's integers are unbounded, so a wrap would show."""
    text = board_with_all_stages(2)
    typed, board = parse_board(text.encode(), "small"), read_board(text)
    rng = np.random.default_rng(seed)
    kind = kept(make_operator, typed, method="support", noise=Noise((5e-6, 5e-6, 2e-5)))
    tables, metadata = dict(kind.tensors), dict(kind.metadata)
    for name in ("support.normal", "support.project"):
        entry, shift = tables[f"{name}.entry"], tables[f"{name}.shift"]
        tables[f"{name}.entry"] = rng.integers(-16383, 16384, entry.shape).astype(np.int16)
        tables[f"{name}.shift"] = rng.integers(0, 26, shift.shape).astype(np.uint8)
        metadata[f"{name}.out_shift"] = str(rng.integers(1, 61))
    if seed % 2:  # positive curvature, so that the steps are taken
        normal = tables["support.normal.entry"]
        tables["support.normal.entry"] = np.where(kind.tensors["support.normal.entry"] > 12000, normal.max(), 0).astype(
            np.int16
        )
    scale = tables["support.scale"]
    tables["support.scale"] = rng.integers(1, 2**31, scale.shape).astype(np.int32)
    file = pack({**tables, **photometric_tables(rng)}, {**base_metadata(typed), **metadata})
    mirror = FramePath(board, file.tensors, file.metadata)
    n_touched = 0
    with Pipeline(typed, file.data) as core:
        n = core.layout.node_n_x * core.layout.node_n_y
        for limit in (3, 3000, 32767):
            u = rng.integers(-limit, limit + 1, (4, n, 3)).astype(np.int16)
            u[:, n // 3 : n // 2, 2] = -limit
            for one_u, force in zip(u, core.solve(u), strict=True):
                expected, mask = mirror.solve_given(one_u.astype(np.int64))
                n_touched += int(mask.any())
                assert np.array_equal(force, expected)
    assert n_touched > 3
