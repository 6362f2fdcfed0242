"""A gripper that feels: adaptive grip of the example, the Gymnasium environment, and the film."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from worlds import BOARD

pytest.importorskip("mujoco", reason="extra [robot]")
pytest.importorskip("gymnasium", reason="extra [robot]")

import gymnasium
from gymnasium.utils.env_checker import check_env
from PIL import Image

from ruffini.errors import InputError
from ruffini.robot import Gripper, Thing, environment
from ruffini.robot.environment import NAME
from ruffini.robot.film import FRAME_MS, Film, surface_points

sys.path.insert(0, str(Path(__file__).parents[3] / "host" / "examples" / "robot"))


def test_both_pads_carry_the_weight_and_a_weak_grip_drops_it(calibrations, tmp_path):
    thing = Thing(mass_kg=0.15, friction=0.6)
    with Gripper(BOARD, thing, calibrations=calibrations) as gripper:
        gripper.grip_n = 2.0
        for i in range(50):
            gripper.lift_m = 0.02 * np.clip((i - 15) / 20, 0, 1)
            frames = gripper.step()
        up = sum(float(np.hypot(*frame.wrench.force[:2])) for frame in frames.values())
        assert up == pytest.approx(0.15 * 9.81, rel=0.05)
        assert all(-frame.wrench.force[2] == pytest.approx(2.0, rel=0.05) for frame in frames.values())
        assert abs(gripper.slipped_m) < 2e-3
        gripper.grip_n = 0.8 * 0.15 * 9.81 / (2 * 0.6)
        for _ in range(25):
            frames = gripper.step()
        assert gripper.slipped_m > 5e-3
        film = Film()
        film.take(gripper, frames, "dropping")
        film.take(gripper, gripper.step(), "dropped")
        assert len(film) == 2
    film.write(tmp_path / "film.gif")
    with Image.open(tmp_path / "film.gif") as kept:
        assert (kept.format, kept.n_frames, kept.info["loop"]) == ("GIF", 2, 0)
        assert kept.info["duration"] == FRAME_MS
        first = np.asarray(kept.convert("RGB"))
        assert len(np.unique(first.reshape(-1, 3), axis=0)) > 10  # scene and pads, no blank sheet
        kept.seek(1)
        assert (np.asarray(kept.convert("RGB")) != first).any()


def test_a_film_that_would_replace_a_folder_is_refused(tmp_path, capsys):
    (tmp_path / "film.gif").mkdir()
    with pytest.raises(SystemExit):
        importlib.import_module("pen_stroke").main(["--film", str(tmp_path / "film.gif")])
    assert "give a .gif in a folder that exists" in capsys.readouterr().err


def test_a_film_draws_each_shape_at_its_size():
    import mujoco

    corners = "0 0 0  .01 0 0  0 .02 0  0 0 .03"
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset><mesh name="m" vertex="{corners}"/></asset><worldbody>
        <geom type="sphere" size=".01"/><geom type="ellipsoid" size=".01 .02 .03"/>
        <geom type="capsule" size=".01 .02"/><geom type="cylinder" size=".01 .02"/>
        <geom type="box" size=".01 .02 .03"/><geom type="mesh" mesh="m"/></worldbody></mujoco>"""
    )
    half = [[0.01] * 3, [0.01, 0.02, 0.03], [0.01, 0.01, 0.03], [0.01, 0.01, 0.02], [0.01, 0.02, 0.03]]
    for geom, wanted in enumerate(half):
        points = surface_points(model, geom)
        np.testing.assert_allclose(np.ptp(points, axis=0) / 2, wanted, rtol=0.01)
    assert len(surface_points(model, 5)) == 4


def test_an_example_draws_on_the_film_that_it_gave(tmp_path):
    """An empty film is false."""
    given, taken = Film(full_n=0.3), []

    def run(feedback, task, board, seed, film):
        taken.append((feedback, task, film is given))

    with pytest.raises(SystemExit):  # nothing was drawn
        importlib.import_module("comparison").compare(
            "x", None, ["--film", str(tmp_path / "a.gif")], goal="", feedbacks=("ours", "none"), run=run, measure=str,
            task=lambda seed: -seed, film=given, film_seeds=(3, 4),
        )  # fmt: skip
    assert taken == [("ours", -3, True), ("ours", -4, True)]


def test_an_empty_film_is_refused(tmp_path):
    with pytest.raises(InputError, match="has no picture"):
        Film().write(tmp_path / "film.gif")


def test_the_example_lifts_what_it_is_not_told(calibrations, monkeypatch):
    import adaptive_grip

    monkeypatch.setattr("ruffini.robot.world.default_calibration", lambda board: calibrations[board.name])
    for name, frames in {"CLOSE": 25, "LIFT": 35, "HOLD": 10, "PUSH": 12, "AFTER": 8}.items():
        monkeypatch.setattr(adaptive_grip, name, frames)
    task = adaptive_grip.Task(Thing(mass_kg=0.2, friction=0.5), (0.0, 0.0, -0.5), 6.0)
    result = adaptive_grip.run("friction", task, BOARD)
    assert result.is_success
    assert 1.0 < result.grip_n / result.least_n < 1.5


@pytest.mark.parametrize(
    "example", ["adaptive_grip", "pen_stroke", "egg_bottle_ball", "hand_guidance", "sort_by_hardness"]
)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--board", "nosuch"], "no board 'nosuch'"),
        (["--board", "gelsight-mini"], "does not measure force_z"),
        (["--board", "eltac"], "does not measure force_x, force_y"),
        (["--seeds", "0"], "give at least 1"),
        (["--film", "nosuch/film.gif"], "a folder that exists"),
        (["--film", "film.mp4"], "give a .gif"),
        (["--film", ""], "give a .gif"),
    ],
)
def test_an_example_refuses_bad_arguments_with_one_sentence(example, arguments, said, capsys):
    with pytest.raises(SystemExit) as caught:
        importlib.import_module(example).main(arguments)
    assert caught.value.code == 2
    printed = capsys.readouterr()
    assert printed.err.startswith(f"{example}: ")
    assert said in printed.err
    assert printed.err.count("\n") == 1
    assert printed.out == ""


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"kind": "pyramid"}, "choose one of box, cylinder, ellipsoid, sphere"),
        ({"kind": "box"}, "3 sizes above zero"),
        ({"size_m": (0.02, -0.03)}, "2 sizes above zero"),
        ({"mass_kg": 0.0}, "a mass above zero"),
        ({"friction": -0.1}, "a friction coefficient"),
    ],
)
def test_things_that_cannot_be_gripped(settings, said):
    with pytest.raises(InputError, match=said):
        Thing(**settings)


def test_a_push_lasts_until_the_next():
    with Gripper(BOARD, Thing(), is_feeling=False) as gripper:
        gripper.push((0.1, 0.0, -0.2))
        gripper.step()
        gripper.push((0.0, 0.3, 0.0))
        gripper.step()
        np.testing.assert_array_equal(gripper.world.data.body("thing").xfrc_applied, [0, 0.3, 0, 0, 0, 0])


def test_gymnasiums_own_check_passes(calibrations, monkeypatch):
    """It resets a dozen times and looks at spaces, types and seeds: pads that hardly touch show the same."""
    monkeypatch.setattr(environment, "CLOSE_FRAMES", 4)
    with gymnasium.make(NAME, board=BOARD, calibrations=calibrations) as env:
        check_env(env.unwrapped, skip_render_check=True)


def test_the_environment_refuses_actions_without_a_grip(calibrations):
    env = gymnasium.make(NAME, board=BOARD, calibrations=calibrations).unwrapped
    with pytest.raises(InputError, match="call reset"):
        env.step(np.array([1.0], np.float32))
    for action in ([np.nan], [1.0, 2.0]):
        with pytest.raises(InputError, match="one finite number"):
            env.step(np.array(action, np.float32))


def test_the_environment_keeps_gymnasiums_rules(calibrations):
    env = gymnasium.make(NAME, board=BOARD, calibrations=calibrations)
    first, _ = env.reset(seed=4)
    again, _ = env.reset(seed=4)
    for name, value in first.items():
        np.testing.assert_array_equal(value, again[name])
    assert env.observation_space.contains(first)
    assert first["wrench"][:, 2] == pytest.approx(-0.6, abs=0.1)
    rewards = [env.step(np.array([grip], np.float32))[1] for grip in (2.0, 4.0)]
    assert rewards == pytest.approx([1 - 2 / 12, 1 - 4 / 12])
    env.close()


def test_environments_side_by_side_are_each_the_one_alone(calibrations, monkeypatch):
    """Processes of their own, as training has them."""
    monkeypatch.setattr(environment, "CLOSE_FRAMES", 4)
    options = {"board": BOARD, "calibrations": calibrations}
    envs = gymnasium.make_vec(NAME, num_envs=2, vectorization_mode="async", **options)
    action = np.array([[1.0], [3.0]], np.float32)
    try:
        first, _ = envs.reset(seed=[4, 5])
        seen, rewards, *_ = envs.step(action)
    finally:
        envs.close()
    for i, seed in enumerate((4, 5)):
        with gymnasium.make(NAME, **options) as env:
            begun, _ = env.reset(seed=seed)
            moved, reward, *_ = env.step(action[i])
        for name in begun:
            np.testing.assert_array_equal(first[name][i], begun[name])
            np.testing.assert_array_equal(seen[name][i], moved[name])
        assert rewards[i] == reward
