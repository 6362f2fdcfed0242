"""Design studies: curves that follow what is known of a linear slab, and what counts as a collapse."""

import json
import os
import shutil

import numpy as np
import pytest
from command_line import run_ruffini

from ruffini.boards import find_board
from ruffini.sim.design import Curve, study
from ruffini.sim.indenters import Indenter, shore_a_modulus

COARSE = "\n[mesh]\ncells_x = 10\ncells_y = 8\n"


@pytest.fixture(scope="module")
def board(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boards") / "gelslim"
    shutil.copytree(find_board("gelslim").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write(COARSE)
    return find_board(folder)


@pytest.fixture(scope="module", autouse=True)
def cache(tmp_path_factory):
    before = os.environ.get("XDG_CACHE_HOME")
    os.environ["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    yield
    if before is None:
        del os.environ["XDG_CACHE_HOME"]
    else:
        os.environ["XDG_CACHE_HOME"] = before


def curve(force):
    force = np.asarray(force, dtype=float)
    return Curve("c", 1e6, 1.0, np.arange(len(force)) * 0.5, force)


def test_where_a_press_collapses():
    assert curve([0, 1, 2, 3]).collapse_n is None
    assert curve([0, 1, 2, 1.99, 2.5]).collapse_n is None  # 0.5 % is no collapse
    assert curve([0, 1, 2, 1.5, 1.2, 3]).collapse_n == 2.0


def test_how_far_a_force_goes():
    assert curve([0, 1, 3]).depth_at(2.0) == pytest.approx(0.75)
    assert curve([0, 1, 3]).depth_at(0.5) == pytest.approx(0.25)
    assert curve([0, 1, 3]).depth_at(4.0) is None


def test_a_slab_is_as_stiff_as_its_rubber_and_stiffer_where_it_is_thin(board):
    curves = study(
        board, shore_a=[20, 40], thickness_mm=[3, 4, 6], indenter=Indenter("flat", 3e-3), depth_mm=0.5
    )  # fmt: skip
    by_label = {c.label: c for c in curves}
    assert list(by_label) == ["as it is", "Shore A 20", "Shore A 40", "3 mm", "4 mm", "6 mm"]
    force = {label: c.force_n[-1] for label, c in by_label.items()}
    assert force["Shore A 40"] / force["Shore A 20"] == pytest.approx(
        shore_a_modulus(40) / shore_a_modulus(20), rel=1e-4
    )
    assert force["Shore A 20"] / force["as it is"] == pytest.approx(
        shore_a_modulus(20) / board.pad.modulus_pa, rel=1e-4
    )
    assert force["4 mm"] == pytest.approx(force["as it is"], rel=1e-9)
    assert force["3 mm"] > 1.2 * force["4 mm"] > 1.2**2 * force["6 mm"]
    # A linear slab under a disc whose edge is all in contact: force goes with depth.
    assert by_label["as it is"].force_n[-1] / by_label["as it is"].force_n[-9] == pytest.approx(
        0.5 / (0.5 * 16 / 24), rel=0.1
    )
    assert all(c.collapse_n is None and not c.ended for c in curves)


def test_a_press_beyond_the_model_ends_with_its_reason(board):
    (one,) = study(board, shore_a=[], thickness_mm=[], indenter=Indenter("flat", 3e-3), depth_mm=4.0)
    assert "press less deep" in one.ended
    assert 1.0 < one.depth_mm[-1] < 2.1


def test_the_verb(board, tmp_path):
    words = ("sim", "design", "--board", board.folder, "--shore-a")
    more = ("30", "--depth-mm", "0.4", "--force-n", "1", "--out", tmp_path / "d.png", "--json")
    done = run_ruffini(*words, *more)
    assert done.code == 0, done.err
    curves = json.loads(done.out)["curves"]
    assert [c["label"] for c in curves] == ["as it is", "Shore A 30"]
    assert curves[1]["depth_at_force_mm"] < curves[0]["depth_at_force_mm"]
    assert (tmp_path / "d.png").read_bytes()[:4] == b"\x89PNG"
    bad = run_ruffini(*words, "soft")
    assert bad.code == 2
    assert "--shore-a 'soft'" in bad.err
