"""The papers' benches: reproduce.toml as strict as a board, runs that go on where they were, the same bytes again."""

import hashlib
import json
import shutil
import tomllib

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.reproduce.make import reproduce
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import load_reproduce, parse_reproduce

COARSE = "\n[mesh]\ncells_x = 10\ncells_y = 8\n"
SMALL = """
schema = 1
paper = "none"
[rig]
force_noise_un = [0, 0, 50000]
depth_noise_um = 20
[aging]
modulus_loss_1e3 = 100
light_loss_1e3 = 200
[[set]]
name = "ball"
part = "fit"
what = "balls"
indenter = ["sphere"]
radius_um = [3000, 4000]
depth_um = 400
step_um = 200
after = [0, 10000]
quick = {radius_um = [4000], after = [0]}
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def board(tmp_path, cache, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    folder = tmp_path / "boards" / "gelslim"
    shutil.copytree(find_board("gelslim").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write(COARSE)
    (folder / "reproduce.toml").write_text(SMALL)
    return find_board(folder)


def bytes_of(folder):
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
            for p in sorted(folder.rglob("*")) if p.is_file()}  # fmt: skip


def test_the_files_hold_what_the_papers_did():
    states = runs_of(load_reproduce(find_board("gelslim")))
    assert [f"S{i}" for i in range(1, 11)] == [r.settings.name for r in states if r.settings.part == "judge"]
    assert sum(r.settings.name in ("objects", "steel_ball") for r in states) == 5
    glitter = runs_of(load_reproduce(find_board("contact-glitter")))
    calibration = [r for r in glitter if r.settings.name == "calibration"]
    assert len(calibration) == 4 * 3 * 7
    assert [p.depth_m for p in calibration[0].poses(30.0)] == pytest.approx(np.arange(1, 26) * 1e-4)
    assert max(r.n_pressed_before for r in glitter) == 10_000


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('what = "balls"', 'what = "balls"\ncolour = 1', "unknown key"),
        ('part = "fit"', 'part = "train"', "part"),
        ("[rig]", "[[set]]\nname = \"ball\"\npart = \"fit\"\nwhat = \"x\"\nindenter = [\"flat\"]\nradius_um = [1]\n"
                  "depth_um = 1\n[rig]", "same name"),
        ("radius_um = [3000, 4000]", "radius_um = []", "radius_um"),
        ('indenter = ["sphere"]\n', "", "needs indenter"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_in_one_sentence(old, new, message):
    with pytest.raises(InputError, match=message):
        parse_reproduce(tomllib.loads(SMALL.replace(old, new, 1)), "reproduce.toml")


def test_the_quick_subset_is_a_subset():
    settings = parse_reproduce(tomllib.loads(SMALL), "reproduce.toml")
    every, quick = runs_of(settings), runs_of(settings, quick=True)
    assert len(every) == 4
    assert [(r.key, r.seed) for r in quick] == [(every[2].key, every[2].seed)]
    assert len({r.seed for r in every}) == 4


def test_runs_go_on_where_they_were_with_the_same_bytes(board, cache, tmp_path):
    out = tmp_path / "out"
    first = reproduce(board, out, quick=True)
    assert (first.n_made, first.n_kept) == (1, 0)
    done = reproduce(board, out)
    assert (done.n_made, done.n_kept, done.failed) == (3, 1, {})
    before = bytes_of(out)
    shutil.rmtree(out / "ball" / "0001")  # a run that was stopped
    (out / "ball" / "0001.part").mkdir()
    (out / "ball" / "0001.part" / "frames").touch()
    again = reproduce(board, out)
    assert (again.n_made, again.n_kept) == (1, 3)
    assert bytes_of(out) == before
    shutil.rmtree(cache / "ruffini" / "twin" / "runs")  # the mechanics solved anew give the same bytes too
    shutil.rmtree(out / "ball" / "0003")
    reproduce(board, out)
    assert bytes_of(out) == before


def test_what_the_bench_read(board, tmp_path):
    out = tmp_path / "out"
    reproduce(board, out)
    truth, rig = (np.load(out / "ball" / "0000" / name) for name in ("truth.npz", "rig.npz"))
    assert json.loads((out / "ball" / "0000" / "run.json").read_text())["chosen"] == {
        "indenter": "sphere", "radius_um": 3000, "after": 0
    }  # fmt: skip
    error = rig["force"] - truth["wrench"]
    assert np.all(error[:, [0, 1, 3, 4, 5]] == 0)
    assert 0.01 < np.std(error[:, 2]) < 0.15  # 50 mN
    touched = np.isfinite(truth["pose"][:, 2])
    offset = (rig["depth_m"] - truth["pose"][:, 2])[touched]
    assert np.ptp(offset) < 1e-12
    assert 0 < abs(offset[0]) < 1e-4
    assert np.all(rig["gel_depth_m"][touched] > 0)
    # A flat pad's contact is no deeper than the ball and no wider than the circle where the ball is 400 um high.
    assert rig["gel_depth_m"][-1] < 400e-6
    assert rig["area_m2"][-1] < np.pi * (2 * 3e-3 * 400e-6)


def test_an_old_unit_is_softer_and_darker(board, tmp_path):
    import cv2

    out = tmp_path / "out"
    reproduce(board, out)
    new, old = out / "ball" / "0000", out / "ball" / "0001"
    force = [np.load(folder / "truth.npz")["wrench"][-1, 2] for folder in (new, old)]
    assert force[1] / force[0] == pytest.approx(0.9, abs=1e-6)
    level = [cv2.imread(str(folder / "frames" / "000000.png")).mean() for folder in (new, old)]
    assert level[1] / level[0] == pytest.approx(0.8, abs=0.03)


def test_recordings_of_other_settings_are_not_mixed(board, tmp_path):
    out = tmp_path / "out"
    reproduce(board, out, quick=True)
    text = (board.folder / "reproduce.toml").read_text()
    (board.folder / "reproduce.toml").write_text(text.replace("depth_noise_um = 20", "depth_noise_um = 21"))
    with pytest.raises(InputError, match="choose another --out"):
        reproduce(find_board(board.folder), out, quick=True)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.tex").touch()
    with pytest.raises(InputError, match="not an empty folder"):
        reproduce(board, tmp_path / "other")


def test_a_board_without_a_paper():
    with pytest.raises(InputError, match="has no paper to reproduce"):
        load_reproduce(find_board("gelsight-mini"))
