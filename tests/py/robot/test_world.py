"""Steps of a world: a program's own applied forces, and what the frames of its pads claim to measure."""

import dataclasses

import numpy as np
import pytest
from worlds import BOARD, WITHOUT_Z, lying, scale

pytest.importorskip("mujoco", reason="extra [robot]")

import ruffini
from ruffini.boards import find_board
from ruffini.device.results import INVALID, NOT_MEASURED, VALID
from ruffini.robot import core_sensor

BALL = 'type="sphere" size=".015"'
WEIGHT_N = 0.1 * 9.81


def test_a_program_that_clears_applied_forces_does_not_lift_the_pad(world):
    one = world(lying(BALL, above_m=0.0151), is_feeling=False)
    one.start()
    for _ in range(400):
        one.data.xfrc_applied[:] = 0.0
        one.advance()
        assert not one.data.xfrc_applied.any()
    assert one.pads["pad"].wrench[2] == pytest.approx(-WEIGHT_N, rel=0.02)


def test_a_program_that_adds_to_applied_forces_adds_to_the_pads(world):
    one = world(lying(BALL, above_m=0.0151), is_feeling=False)
    one.start()
    body = one.data.body("object")
    for i in range(400):
        if i == 150:  # it lies on the pad
            body.xfrc_applied[2] -= 0.5
        one.advance()
    np.testing.assert_array_equal(body.xfrc_applied, [0, 0, -0.5, 0, 0, 0])
    assert one.pads["pad"].wrench[2] == pytest.approx(-WEIGHT_N - 0.5, rel=0.02)


def pressed(one, press_n):
    one.data.ctrl[:] = 0.0, 0.2, -press_n
    return [one.step()["pad"] for _ in range(25)][-1]


def test_what_the_board_does_not_measure_is_not_a_number_here_too(world):
    frame = pressed(world(scale(BALL), board=WITHOUT_Z), 1.0)
    assert set(find_board(WITHOUT_Z).board.not_measured) == {"force_z", "torque_x", "torque_y", "depth"}
    assert frame.wrench.validity == (VALID, VALID, NOT_MEASURED, NOT_MEASURED, NOT_MEASURED, VALID)
    assert np.isnan(frame.wrench.values).tolist() == [False, False, True, True, True, False]
    assert frame.wrench.force[1] == pytest.approx(0.2, abs=0.05)
    assert frame.flags == ("FLAG_UNCALIBRATED_Z",)
    assert frame.is_valid
    contact = frame.contacts.contacts[0]
    assert np.isnan(contact.force).all()  # as a device sends it: a contact has the validity of its z
    assert contact.slip_state is None
    assert frame.field.validity == (VALID, VALID, NOT_MEASURED)
    assert frame.field.slip is None


def test_a_press_out_of_range_is_invalid_and_knows_no_slip(world):
    one = world(scale(BALL))
    frame = pressed(one, 1.0)
    assert frame.wrench.validity == (VALID,) * 6
    assert frame.flags == ()
    assert frame.contacts.contacts[0].slip_state == "sticks"
    one._sensors["pad"]._limit = 100  # steps: 12 um
    frame = pressed(one, 1.0)
    assert frame.wrench.validity == (INVALID,) * 6
    assert frame.flags == ("FLAG_OVER_RANGE",)
    assert not frame.is_valid
    assert np.isnan(frame.wrench.force).all()
    assert frame.contacts.contacts[0].slip_state is None
    assert frame.field.slip is None


@pytest.fixture
def made(tmp_path, monkeypatch):
    """How often the default operator is made; its cache is in `tmp_path`."""
    calls = []

    def make(board, **settings):
        calls.append(settings)
        return dataclasses.make_dataclass("Kind", ["tensors", "metadata"])({}, {"operator.method": "support"})

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("ruffini.estimators.operator.fit.make_operator", make)
    return calls


def test_a_default_calibration_is_made_once_for_each_board_setting_and_code(made, tmp_path, monkeypatch):
    board = find_board(BOARD)
    first = core_sensor.default_calibration(board)
    assert core_sensor.default_calibration(board) == first
    assert len(made) == 1
    monkeypatch.setattr(core_sensor, "NOISE_M", (1e-6, 1e-6, 1e-6))
    core_sensor.default_calibration(board)
    assert len(made) == 2
    monkeypatch.setattr(np, "__version__", "another")
    core_sensor.default_calibration(board)
    assert len(made) == 3
    (tmp_path / "package").mkdir()
    monkeypatch.setattr(ruffini, "__file__", str(tmp_path / "package" / "__init__.py"))
    core_sensor.default_calibration(board)
    assert len(made) == 4
    (tmp_path / "package" / "fem.py").write_text("another element")
    core_sensor.default_calibration(board)
    assert len(made) == 5
    assert len(list((tmp_path / "ruffini" / "robot").iterdir())) == 5  # whole files, and no parts


def test_a_cache_that_cannot_be_written_is_no_error(made, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert core_sensor.default_calibration(find_board(BOARD))
    assert len(made) == 1


def three_fingers(mass: float) -> str:
    """Fingers on slides, 120 degrees apart, whose motors press a free ball that nothing else holds."""
    fingers, motors = "", ""
    for i, angle in enumerate((0.0, 2 * np.pi / 3, 4 * np.pi / 3)):
        x, y = np.cos(angle), np.sin(angle)
        fingers += f"""<body name="f{i}" pos="{0.0152 * x} {0.0152 * y} 0">
        <joint name="f{i}" type="slide" axis="{-x} {-y} 0" damping="20"/>
        <geom type="box" size=".004 .004 .004" pos="{0.009 * x} {0.009 * y} 0" mass="0.1" contype="0" conaffinity="0"/>
        <site name="f{i}" zaxis="{-x} {-y} 0"/></body>"""
        motors += f'<motor joint="f{i}"/>'
    return f"""<mujoco><option timestep="5e-4" integrator="implicitfast"/><worldbody>{fingers}
    <body name="object"><freejoint/><geom type="sphere" size=".015" mass="{mass}" friction="0.8 .005 .0001"/></body>
    </worldbody><actuator>{motors}</actuator></mujoco>"""


def test_three_fingers_carry_a_ball_together(world):
    mass = 0.05
    one = world(three_fingers(mass), pads=("f0", "f1", "f2"))
    one.data.ctrl[:] = 1.0
    one.model.opt.gravity[:] = 0.0
    for _ in range(25):
        one.step()
    one.model.opt.gravity[2] = -9.81
    for _ in range(25):
        frames = one.step()
    total = np.zeros(3)
    for name, frame in frames.items():
        assert frame.is_valid
        assert frame.wrench.force[2] == pytest.approx(-1.0, abs=0.1)
        total += one.data.site(name).xmat.reshape(3, 3) @ frame.wrench.force
    np.testing.assert_allclose(total, [0, 0, -mass * 9.81], atol=0.05)
    assert np.abs(one.data.body("object").xpos).max() < 1e-3
