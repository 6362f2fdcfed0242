"""The stage contact_model against the mirror, bit for bit, and what it flags."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.contact_model import ContactModel, ContactProfile
from mirror.fixed import Saturations
from mirror.helmholtz import Helmholtz
from pressed_texture import NUMBERS, Tensors, board_text, pressed, rested, tables, texture

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError

NOT_MEASURED, VALID, INVALID = 0, 1, 3
MARKERS_LOST, OVER_RANGE = 8, 32


def opened(kind: Tensors, **numbers: int) -> Pipeline:
    board = parse_board(board_text().encode(), "small")
    metadata = {f"contact_model.{k}": str(v) for k, v in {**NUMBERS, **numbers}.items()}
    return Pipeline(board, pack(kind, {**base_metadata(board), "wrench.features": "markers", **metadata}).data)


def test_profile_and_contact_over_two_presses() -> None:
    rng, rest = np.random.default_rng(2), texture()
    kind = tables(rng, 63)
    mirror_profile, mirror = ContactProfile(read_board(board_text())), ContactModel(kind, NUMBERS)
    mirror_parts, turned, parts = Helmholtz(read_board(board_text())), [], []
    saturations, depths, told = Saturations(), [], 0
    path = [
        (0.2, 0),
        (1.0, 0),
        (1.5, 0),
        (2.0, 0),
        (2.4, 0),
        (2.8, 0),
        (2.0, 0),
        (0.0, 0),
        (1.2, 3),
        (1.8, 0),
        (2.2, 0),
        (2.6, 1),
    ]
    with opened(kind) as core:
        rested(core, rest)
        for out_px, shift_px in path:
            said = core.process(pressed(rest, out_px, shift_px))
            _, _, lost = core.markers()
            profile = mirror_profile.run(core.features().reshape(-1, 2), lost.ravel().astype(np.int64))
            row = core.profile()
            assert [*row.radial_q4.tolist(), *row[1:]] == profile.row()
            flow = mirror_profile.flow(core.features().reshape(-1, 2))
            gradient, sums = mirror_parts.run(flow, profile.center, saturations)
            assert np.array_equal(core.curl_free_flow_q4(), gradient)
            assert [*core.helmholtz()] == sums
            parts.append(sums[0])
            turned.append(sums[2])
            is_wrong = bool(said.flags & ~(OVER_RANGE if profile.lost <= 250 else 0))
            expected = mirror.run(profile, said.wrench_un.tolist(), not is_wrong, saturations)
            told_row = core.modelled()
            assert [*told_row[:12], *told_row[14:]] == expected
            depths.append(expected[3])
            told += expected[1] != 0
            assert core.modelled().hardness_validity == (VALID if expected[1] else NOT_MEASURED)
    assert told >= 4
    assert max(parts) > 16 * 30
    assert len(set(turned)) > 5
    assert max(depths) > 1000


def test_what_is_strange_or_too_deep_is_invalid_and_what_is_covered_is_not_told() -> None:
    rng, rest = np.random.default_rng(2), texture()
    kind = tables(rng, 63)
    with opened(kind, most_strange_q8=1) as core:
        rested(core, rest)
        for out_px in (1.0, 1.5, 2.0, 2.4):
            core.process(pressed(rest, out_px))
        assert core.modelled().is_strange
        assert core.modelled().hardness_validity == core.modelled().depth_validity == INVALID
    with opened(kind, most_failing_q12=1) as core:
        rested(core, rest)
        for out_px in (1.0, 1.5, 2.0, 2.4):
            core.process(pressed(rest, out_px))
        assert core.modelled().is_strange
        assert core.modelled().hardness_validity == INVALID
    deep = dict(kind)
    deep["contact_model.size_out"] = kind["contact_model.size_out"] * np.array([[8], [1], [1], [1]], np.int32)
    with opened(deep) as core:
        rested(core, rest)
        said = core.process(pressed(rest, 2.4))
        assert said.flags & OVER_RANGE
        assert core.modelled().depth_validity == INVALID
    with opened(kind) as core:
        rested(core, rest)
        covered = pressed(rest, 2.0)
        covered[:, 40:110] = 90
        said = core.process(covered)
        assert said.flags & MARKERS_LOST
        assert VALID not in said.wrench_validity


@pytest.mark.parametrize(
    ("n_covered", "pause_s", "is_told"),
    [
        (0, 0.0, True), (2, 0.0, True), (3, 0.0, False),  # nobody exchanges an object in two frames
        (0, 0.4, True), (0, 0.6, False),
    ],
)  # fmt: skip
def test_where_another_object_may_press_since_hardness_is_not_told_until_nothing_does(
    n_covered: int, pause_s: float, is_told: bool
) -> None:
    rest = texture()
    kind = tables(np.random.default_rng(2), 63)
    mirror_profile, mirror = ContactProfile(read_board(board_text())), ContactModel(kind, NUMBERS)
    covered = pressed(rest, 2.0)
    covered[:, 40:110] = 90
    at_s, saturations = 1.0, Saturations()
    with opened(kind) as core:
        rested(core, rest)

        def show(picture: npt.NDArray[np.uint8], after_s: float = 0.02) -> int:
            nonlocal at_s
            at_s += after_s
            said = core.process(picture, at_s)
            _, _, lost = core.markers()
            profile = mirror_profile.run(core.features().reshape(-1, 2), lost.ravel().astype(np.int64))
            is_wrong = bool(said.flags & ~(OVER_RANGE | (MARKERS_LOST if profile.lost > 250 else 0)))
            us = round(at_s * 1e6)
            expected = mirror.run(profile, said.wrench_un.tolist(), not is_wrong, saturations, us)
            row = core.modelled()
            assert [*row[:12], *row[14:]] == expected
            return int(row.hardness_validity)

        for out_px in (1.0, 1.5, 2.0, 2.2):
            before = show(pressed(rest, out_px))
        assert before == VALID
        for _ in range(n_covered):
            assert show(covered) != VALID
        after = [show(pressed(rest, out_px), 0.02 if i else 0.02 + pause_s) for i, out_px in
                 enumerate((1.2, 1.5, 1.9, 2.2))]  # fmt: skip
        assert after == [VALID if is_told else NOT_MEASURED] * 4
        show(pressed(rest, 0.0))
        assert [show(pressed(rest, out_px)) for out_px in (1.0, 1.5, 2.0, 2.2)][-1] == VALID


@pytest.mark.parametrize(
    ("times", "out_px", "validity"),
    [
        (0.37, (1.0, 1.5, 2.0, 2.35), NOT_MEASURED),  # up to 0.39 mm deep
        (1.0, (1.0, 1.5, 2.0), VALID),
        (4.2, (1.0, 1.1, 1.2, 1.3), NOT_MEASURED),  # from 1.84 mm on, but within range
    ],
)
def test_hardness_is_told_of_presses_between_0_4_and_1_8_mm_alone(
    times: float, out_px: tuple[float, ...], validity: int
) -> None:
    kind, rest = tables(np.random.default_rng(2), 63), texture()
    gel = np.array([[times], [1], [1], [1]])
    kind["contact_model.size_out"] = np.round(kind["contact_model.size_out"] * gel).astype(np.int32)
    with opened(kind) as core:
        rested(core, rest)
        for each in out_px:
            said = core.process(pressed(rest, each))
            depth = core.modelled().gel_depth_um
            assert (400 <= depth <= 1800) == (validity == VALID)
            assert 0 < depth < 2500
            assert not said.flags
            assert core.modelled().depth_validity == VALID
        assert core.modelled().hardness_validity == validity


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("contact_model.sigma", np.zeros((2, 10), np.int32), "sigma"),
        ("contact_model.tanh", np.ones(513, np.int16), "tanh"),
        ("contact_model.kind_hidden", np.zeros((65, 19), np.int32), "kind_hidden"),
        ("contact_model.fails_out", np.zeros((1, 3), np.int32), "fails_out"),
        ("contact_model.planar_shift", np.array([0, 3], np.uint8), "planar_shift"),
        ("contact_model.mean", np.zeros(15, np.int16), "mean"),
    ],
)
def test_bad_tables_are_refused(name: str, value: npt.NDArray[np.generic], why: str) -> None:
    kind = tables(np.random.default_rng(2), 63) | {name: value}
    with pytest.raises(InputError, match=why):
        opened(kind)


def test_a_contact_model_without_a_wrench_is_refused() -> None:
    kind = {k: v for k, v in tables(np.random.default_rng(2), 63).items() if k.startswith("contact_model.")}
    with pytest.raises(InputError, match="without wrench"):
        opened(kind)
