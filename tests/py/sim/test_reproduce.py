"""The papers' benches: reproduce.toml as strict as a board, runs that go on where they were, the same bytes again."""

import hashlib
import json
import shutil

import numpy as np
import pytest
import tomllib

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.programs import Load
from ruffini.sim.reproduce.make import digest, mount_zero, readings, reproduce
from ruffini.sim.reproduce.runs import runs_of
from ruffini.sim.reproduce.settings import HandSet, load_reproduce, parse_reproduce
from ruffini.sim.reproduce.solved import KeptMoment, slowed
from ruffini.sim.reproduce.warmth import celsius_read, risen, warmer_k

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


DRAWN = """
schema = 1
paper = "none"
[[set]]
name = "any"
part = "fit"
what = "drawn"
indenter = ["flat", "square"]
radius_um = [3000, 6000]
at_um = [[-5000, -1000], [5000, 1000]]
tilt_mrad = [[-700, 0], [700, 0]]
depth_um = 400
step_um = 200
drawn = 40
quick = {}
"""


def test_drawn_runs_fill_their_ranges_and_stay_when_more_are_drawn():
    settings = parse_reproduce(tomllib.loads(DRAWN), "reproduce.toml")
    runs = runs_of(settings)
    assert len(runs) == 40
    chosen = [run.chosen for run in runs]
    radii, places = np.array([c["radius_um"] for c in chosen]), np.array([c["at_um"] for c in chosen])
    assert {c["indenter"] for c in chosen} == {"flat", "square"}
    assert radii.min() >= 3000
    assert radii.max() <= 6000
    assert len(set(radii.tolist())) > 35
    assert (np.abs(places) <= [5000, 1000]).all()
    assert np.ptp(places, axis=0) == pytest.approx([10000, 2000], rel=0.25)
    assert {c["tilt_mrad"][1] for c in chosen} == {0}
    assert [run.poses(30.0)[0].x_m for run in runs] == pytest.approx(places[:, 0] * 1e-6)
    more = runs_of(parse_reproduce(tomllib.loads(DRAWN.replace("= 40", "= 50")), "reproduce.toml"))
    assert [(r.key, r.seed, r.chosen) for r in more[:40]] == [(r.key, r.seed, r.chosen) for r in runs]
    assert [r.key for r in runs_of(settings, quick=True)] == [f"any/{i:04d}" for i in range(0, 40, 8)]


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
    shutil.rmtree(cache / "ruffini" / "twin" / "runs")  # the mechanics solved again give the same bytes too
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


def test_a_bench_without_a_quick_subset_says_so(board, tmp_path):
    (board.folder / "reproduce.toml").write_text(SMALL[: SMALL.index("quick")])
    with pytest.raises(InputError, match=r"reproduce\.toml of gelslim has no quick subset: leave --quick out"):
        reproduce(find_board(board.folder), tmp_path / "out", quick=True)
    assert not (tmp_path / "out").exists()


def test_a_board_without_a_paper():
    with pytest.raises(InputError, match="has no paper to reproduce"):
        load_reproduce(find_board("gelsight-mini"))


def test_each_run_has_its_own_zero_of_its_indenters_mount():
    settings = load_reproduce(find_board("contact-glitter"))
    runs = [r for r in runs_of(settings) if r.settings.name == "calibration"]
    of = {m.indenter: m for m in settings.mount}
    for shape in ("triangle", "flat", "square", "sphere"):
        zeros = np.array([mount_zero(r, settings.mount) for r in runs if r.chosen["indenter"] == shape])
        assert (zeros[:, 2] == 0).all()  # tared along the press
        spread = np.sqrt((zeros**2).mean(axis=0))
        assert spread[:2] == pytest.approx(of[shape].zero_force_un * 1e-6, rel=0.5)
        assert spread[3:] == pytest.approx(of[shape].zero_torque_unm * 1e-6, rel=0.5)
    assert mount_zero(runs[0], settings.mount).tolist() == mount_zero(runs[0], settings.mount).tolist()
    assert not mount_zero(runs[0], []).any()


def test_a_recorded_run_reads_its_mounts_zero_on_top(board, tmp_path):
    reproduce(board, tmp_path / "none", quick=True)
    table = '\n[[mount]]\nindenter = "sphere"\nzero_force_un = 2000000\nzero_torque_unm = 90000\n'
    with (board.folder / "reproduce.toml").open("a") as file:
        file.write(table)
    mounted = find_board(board.folder)
    reproduce(mounted, tmp_path / "mounted", quick=True)
    settings = load_reproduce(mounted)
    run = runs_of(settings, quick=True)[0]
    read = [np.load(tmp_path / name / run.key / "rig.npz")["force"] for name in ("none", "mounted")]
    zero = mount_zero(run, settings.mount)
    assert zero[[0, 1, 3, 4, 5]].all()
    assert read[1] - read[0] == pytest.approx(np.tile(zero, (len(read[0]), 1)), abs=1e-12)


def test_mounts_count_in_the_digest(tmp_path):
    folder = tmp_path / "contact-glitter"
    shutil.copytree(find_board("contact-glitter").folder, folder)
    before = digest(find_board(folder))
    text = (folder / "reproduce.toml").read_text()
    (folder / "reproduce.toml").write_text(text.replace("zero_force_un = 400000", "zero_force_un = 400001"))
    assert digest(find_board(folder)) != before


def test_more_runs_of_a_drawn_set_keep_those_that_are_there(tmp_path):
    folder = tmp_path / "contact-glitter"
    shutil.copytree(find_board("contact-glitter").folder, folder)

    def with_bench(text: str) -> str:
        (folder / "presses.toml").write_text(text)
        return digest(find_board(folder), "presses.toml")

    before = with_bench(DRAWN)
    assert with_bench(DRAWN.replace("drawn = 40", "drawn = 50")) == before
    assert with_bench(DRAWN.replace("6000]", "6001]")) != before
    assert with_bench(DRAWN.replace("drawn = 40\n", "")) != before


def test_the_seven_objects_are_seven():
    runs = [r for r in runs_of(load_reproduce(find_board("contact-glitter"))) if r.settings.name.startswith("object_")]
    assert len(runs) == 7
    assert len({(r.chosen["indenter"], r.chosen["radius_um"], r.chosen["shore_a"]) for r in runs}) == 7


def test_a_bench_rings_when_it_touches_and_less_from_frame_to_frame():
    settings = load_reproduce(find_board("stereo-fingertip"))
    rig = settings.rig.model_copy(update={"force_noise_un": [0, 0, 0], "ring_force_un": 100_000})
    poses = np.zeros((12, 6))
    poses[:4] = np.nan
    read = np.array([readings(r, rig, np.zeros((12, 6)), poses, 30.0)["force"] for r in runs_of(settings)])
    assert not read[:, :4].any()
    assert not read[:, :, [0, 1, 3, 4, 5]].any()
    spread = np.sqrt((read[:, 4:, 2] ** 2).mean(axis=0))
    assert spread == pytest.approx(0.1 * 0.6 ** np.arange(8), rel=0.35)


def test_slow_loops_take_as_many_frames_as_fast_ones():
    loops = [r for r in runs_of(load_reproduce(find_board("eltac"))) if r.settings.name == "loops"]
    for run in loops:
        every, speed_um_s = run.frame_every(30.0), run.chosen["speed_um_s"]
        poses = run.poses(30.0 / every)
        assert 60 <= len(poses) <= 120  # in steps of about 0.1 mm
        assert max(p.depth_m for p in poses) == pytest.approx(4e-3)
        assert poses[1].depth_m - poses[0].depth_m == pytest.approx(speed_um_s * 1e-6 * every / 30, rel=0.02)
    assert [run.frame_every(30.0) for run in loops] == [30, 6, 3, 1, 1]


def test_a_slow_run_has_a_slow_camera(coarse_unit):
    run = next(r for r in runs_of(load_reproduce(find_board("eltac"))) if r.chosen.get("speed_um_s") == 500)
    rate = coarse_unit.board.camera.rate_mhz
    assert slowed(coarse_unit, run).frame_s == pytest.approx(run.frame_every(rate * 1e-3) * coarse_unit.frame_s)
    assert coarse_unit.board.camera.rate_mhz == rate


def test_hand_loads_are_as_large_as_the_set_says():
    board = find_board("ftouch")
    spread = {}
    for run in runs_of(load_reproduce(board)):
        if isinstance(run.settings, HandSet):
            loads = [step.wrenches for step in run.story(board) if isinstance(step, Load)]
            spread.setdefault(run.settings.name, []).extend(loads)
    paper = np.concatenate(spread["connector"]).std(axis=0)
    # RMSE / sqrt(1 - R2) of Table III: how far the paper's own loads spread.
    expected = np.array([0.018, 0.016, 0.094, 0.657e-3, 1.566e-3, 0.407e-3])
    expected /= np.sqrt(1 - np.array([0.99, 0.99, 0.94, 0.96, 0.94, 0.85]))
    assert paper == pytest.approx(expected, rel=0.2)
    assert (np.concatenate(spread["range"]).std(axis=0) > 1.2 * paper).all()


def test_takes_of_a_warm_bench_are_warmer_after_their_rest():
    """Stiffness by the run's temperature, a tray that rose, and what the thermometer says of it."""
    settings = load_reproduce(find_board("ftouch"), "warm.toml")
    runs = runs_of(settings)
    assert [warmer_k(r) for r in runs[::17]] == [0.0, 8.0, 16.0]
    assert warmer_k(runs_of(load_reproduce(find_board("gelslim")))[0]) == 0.0
    celsius = celsius_read(runs[-1], settings.warmth, 40, 10)
    assert celsius[:10].mean() == pytest.approx(23.0, abs=0.15)
    assert celsius[10:].mean() == pytest.approx(39.0, abs=0.1)
    cold = [KeptMoment({"tray": np.zeros((4, 6))}, i) for i in range(4)]
    warm = risen(cold, settings.warmth, 16.0, 2)
    assert [m.tray.shift_m[2] for m in warm] == pytest.approx([0, 0, 24e-6, 24e-6])
    assert cold[3].tray.shift_m[2] == 0.0
