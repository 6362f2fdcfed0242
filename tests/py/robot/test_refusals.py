"""Worlds that cannot be simulated are refused before they are, with one sentence and a remedy."""

import pytest
from worlds import BOARD, lying

pytest.importorskip("mujoco", reason="extra [robot]")

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.errors import InputError
from ruffini.robot import World

BALL = 'type="sphere" size=".015"'
# A prism of twelve sides, 30 mm across: to a pad of 16 mm its round side is flats of 8 mm.
COARSE = """<mujoco><option timestep="0.001"/><asset><mesh name="can" vertex="{}"/></asset><worldbody>
<body name="finger"><geom type="box" size=".01 .008 .01" pos="0 0 -.015"/><site name="pad"/></body>
<body name="object" pos="0 0 .04"><freejoint/><geom type="mesh" mesh="can" mass=".1"/></body></worldbody></mujoco>"""


def prism(n):
    import numpy as np

    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return " ".join(f"{0.015 * np.cos(a):.6f} {0.015 * np.sin(a):.6f} {z}" for a in angles for z in (-0.01, 0.01))


def refusal(xml, board=BOARD, pad="pad", **options):
    with pytest.raises(InputError) as caught, World(xml, {pad: board}, is_feeling=False, **options) as world:
        world.start()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_world_in_millimetres():
    xml = lying('type="sphere" size="15"', above_m=15).replace('size=".01 .008 .01"', 'size="10 8 10"')
    assert "MuJoCo counts in metres" in refusal(xml)
    assert "0.001" in refusal(xml)


def test_a_step_too_long_names_one_that_does():
    said = refusal(lying(BALL, above_m=0.0151, step_s=4e-3))
    assert "a step of 4 ms is too long for pad 'pad'" in said
    step = said.split('timestep="')[1].split('"')[0]
    with World(lying(BALL, above_m=0.0151, step_s=float(step)), {"pad": BOARD}, is_feeling=False) as world:
        world.start()
    assert "too long" in refusal(lying(BALL, above_m=0.0151, step_s=float(step)), stiffness=4.0)


def test_a_pad_inside_an_object():
    said = refusal(lying(BALL, above_m=0.010))
    assert said.startswith("pad 'pad' starts 5.0 mm inside 'object'")
    assert "move one of them away" in said


def test_a_mesh_too_coarse_for_the_pad():
    said = refusal(COARSE.format(prism(12)))
    assert "mesh 'can' is too coarse for pad 'pad'" in said
    assert "export it finer" in said
    with World(COARSE.format(prism(60)), {"pad": BOARD}, is_feeling=False) as world:
        world.start()


def test_an_integrator_that_takes_no_forces():
    assert "RK4" in refusal(lying(BALL, above_m=0.0151).replace("implicitfast", "RK4"))


@pytest.mark.parametrize(("board", "kind"), [("eltac", "tube"), ("stereo-fingertip", "dome"), ("ftouch", "platform")])
def test_boards_without_a_flat_pad(board, kind):
    assert f"board {board!r} is a " in refusal(lying(BALL, above_m=0.0151), board)
    assert kind in refusal(lying(BALL, above_m=0.0151), board)


HEIGHT_FIELD = """<mujoco><asset><hfield name="hill" nrow="2" ncol="2" size=".1 .1 .01 .01"/></asset><worldbody>
<geom name="ground" type="hfield" hfield="hill" pos="0 0 -.1" {}/>
<body name="finger"><joint type="slide"/><geom type="box" size=".01 .008 .01" pos="0 0 -.015"/><site name="pad"/></body>
</worldbody></mujoco>"""


def test_a_height_field_that_may_touch():
    said = refusal(HEIGHT_FIELD.format(""))
    assert "pad 'pad' cannot touch geom 'ground'" in said
    assert "a mesh or a primitive shape" in said
    with World(HEIGHT_FIELD.format('contype="0" conaffinity="0"'), {"pad": BOARD}, is_feeling=False):
        pass


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"pads": {}}, "has no pads"),
        ({"stiffness": 0.0}, "above zero"),
        ({"stiffness": float("nan")}, "above zero"),
        ({"noise_m": (1e-6, 1e-6)}, "three standard deviations"),
        ({"noise_m": (1e-6, 1e-6, -1e-6)}, "none below zero"),
    ],
)
def test_settings_without_sense(options, said):
    with pytest.raises(InputError, match=said):
        World(lying(BALL, above_m=0.0151), **{"pads": {"pad": BOARD}, "is_feeling": False, **options})


def test_a_board_whose_core_makes_no_forces_of_displacements_is_refused_before_the_first_step():
    with pytest.raises(InputError, match="'contact-glitter' makes its forces from pictures"):
        World(lying(BALL, above_m=0.0151), {"pad": "contact-glitter"})
    empty = container.pack({}, container.base_metadata(find_board(BOARD))).data
    with pytest.raises(InputError, match=r"no wrench, contacts, slip of displacements: give pad 'pad' a calibration"):
        World(lying(BALL, above_m=0.0151), {"pad": BOARD}, calibrations={BOARD: empty})


def test_names_and_files():
    assert "no site or geom 'thumb'" in refusal(lying(BALL, above_m=0.0151), pad="thumb")
    assert "is no box" in refusal(lying(BALL.replace("type", 'name="round" type'), above_m=0.0151), pad="round")
    assert "not MJCF" in refusal("<mujoco><nonsense/></mujoco>")
