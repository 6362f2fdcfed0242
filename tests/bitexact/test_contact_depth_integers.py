"""The stage contact_depth against the mirror, bit for bit, and when its map is worth nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from mirror.board import read_board
from mirror.contact_depth import ContactDepth
from mirror.contact_model import ContactProfile, inputs_of
from mirror.fixed import Saturations
from pressed_texture import NUMBERS, Tensors, board_text, pressed, rested, tables, texture

from ruffini.boards import parse_board
from ruffini.calibrate.container import base_metadata, pack
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.fem.compile import compile_matrix
from ruffini.fem.symmetry import Sites

NOT_MEASURED, VALID, INVALID = 0, 1, 3
N = 63
TEXT = board_text("contact_depth")


def depth_tables(rng: np.random.Generator) -> tuple[Tensors, dict[str, str]]:
    """Any linear estimate, and a net of any weights that says some three times the profile's size."""
    place = rng.uniform(size=(N, 3))
    sites = Sites(place, np.full(N, 2)), Sites(np.repeat(place, 2, axis=0), np.tile([0, 1], N))
    compiled = compile_matrix(rng.normal(size=(N, 2 * N)), *sites, "any", max_error=1e-2)
    out = rng.integers(-(1 << 15), 1 << 15, (1, 8)).astype(np.int32)
    out[0, -1] = 12_000 << 5
    return compiled.program.tensors("contact_depth.linear") | {
        "contact_depth.net_hidden": rng.integers(-(1 << 13), 1 << 13, (7, 25)).astype(np.int32),
        "contact_depth.net_out": out, "contact_depth.net_shift": np.array([17, 20], np.uint8),
    }, {"contact_depth.linear.out_shift": str(compiled.program.out_shift), "contact_depth.sigma_um": "95"}  # fmt: skip


def opened(kind: Tensors, told: dict[str, str], **numbers: int) -> Pipeline:
    board = parse_board(TEXT.encode(), "small")
    metadata = {f"contact_model.{k}": str(v) for k, v in {**NUMBERS, **numbers}.items()}
    file = pack(kind, {**base_metadata(board), "wrench.features": "markers", **metadata, **told})
    return Pipeline(board, file.data)


def all_tables() -> tuple[Tensors, dict[str, str]]:
    rng = np.random.default_rng(3)
    kind = tables(rng, N)
    more, told = depth_tables(rng)
    return kind | more, told


def test_the_map_is_the_mirrors() -> None:
    rest, (kind, told) = texture(), all_tables()
    mirror, profile_of = ContactDepth(read_board(TEXT), kind, told), ContactProfile(read_board(TEXT))
    saturations, deepest, flattest = Saturations(), 0, 0
    with opened(kind, told) as core:
        rested(core, rest)
        assert (core.layout.depth_n_x, core.layout.depth_n_y) == (150 // mirror.step_px, 113 // mirror.step_px)
        assert core.layout.depth_step_px == mirror.step_px > 1
        for out_px, shift_px in ((0.0, 0.0), (0.6, 0.0), (1.5, 0.0), (2.4, 1.0), (2.8, -3.0), (0.0, 0.0)):
            said = core.process(pressed(rest, out_px, shift_px))
            if core.modelled().is_touched:
                moved = core.features().reshape(-1, 2)
                _, _, lost = core.markers()
                profile, flow = profile_of.run(moved, lost.ravel().astype(np.int64)), profile_of.flow(moved)
                inputs = inputs_of(profile, -int(said.wrench_un[2]))
                expected = mirror.run(flow, profile_of.fall(flow), profile, inputs, saturations)
                deepest, flattest = min(deepest, int(expected.min())), max(flattest, int(expected.max()))
            else:
                expected = np.zeros((core.layout.depth_n_y, core.layout.depth_n_x), np.int64)
            assert np.array_equal(core.raw("depth"), expected), (out_px, shift_px)
            assert said.depth_validity == (INVALID if said.flags & ~6 else VALID)
    assert deepest < -8 * 100
    assert flattest > deepest / 2  # and it is no constant


def test_what_no_model_holds_for_has_no_depth_and_without_tables_there_is_no_map() -> None:
    rest, (kind, told) = texture(), all_tables()
    with opened(kind, told, most_strange_q8=1) as core:
        rested(core, rest)
        said = [core.process(pressed(rest, out_px)).depth_validity for out_px in (1.0, 1.5, 2.0, 2.4)]
        assert core.modelled().is_strange
        assert said[-1] == INVALID
    bare = {name: table for name, table in kind.items() if not name.startswith("contact_depth.")}
    with opened(bare, {}) as core:
        rested(core, rest)
        assert core.process(pressed(rest, 1.5)).depth_validity == NOT_MEASURED


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("contact_depth.net_hidden", np.zeros((7, 24), np.int32), "net_hidden"),
        ("contact_depth.net_shift", np.array([0, 3], np.uint8), "net_shift"),
        ("contact_depth.linear.fold", np.ones((5, 1), np.int32), "linear"),
    ],
)
def test_bad_tables_are_refused(name: str, value: npt.NDArray[Any], why: str) -> None:
    kind, told = all_tables()
    with pytest.raises(InputError, match=why):
        opened(kind | {name: value}, told)


def test_a_map_without_its_sigma_is_refused() -> None:
    kind, told = all_tables()
    with pytest.raises(InputError, match="sigma_um"):
        opened(kind, {k: v for k, v in told.items() if k != "contact_depth.sigma_um"})
