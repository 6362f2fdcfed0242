"""Undersides of geoms against MuJoCo's own rays."""

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="extra [robot]")

import mujoco

from ruffini.robot.attached import KINDS
from ruffini.robot.shapes import Hull, entry

GEOMS = {
    "sphere": 'type="sphere" size=".02"',
    "ellipsoid": 'type="ellipsoid" size=".02 .01 .03"',
    "capsule": 'type="capsule" size=".01 .02"',
    "cylinder": 'type="cylinder" size=".015 .02"',
    "box": 'type="box" size=".02 .01 .015"',
    "mesh": 'type="mesh" mesh="wedge"',
}
MODEL = """<mujoco><asset><mesh name="wedge" vertex="-.02 -.02 0 .02 -.02 0 0 .03 0 0 0 .025 .01 .01 .02"/></asset>
<worldbody><body><freejoint/><geom {} mass="1"/></body></worldbody></mujoco>"""


@pytest.mark.parametrize("kind", GEOMS)
def test_rays_enter_where_mujocos_do(kind):
    model = mujoco.MjModel.from_xml_string(MODEL.format(GEOMS[kind]))
    data = mujoco.MjData(model)
    assert KINDS[mujoco.mjtGeom(model.geom_type[0])] == kind
    size, hull = model.geom_size[0], None
    if kind == "box":
        hull = Hull(np.vstack([np.eye(3), -np.eye(3)]), np.concatenate([size, size]))
    elif kind == "mesh":
        hull = Hull.of_mesh(model, 0)
    rng = np.random.default_rng(5)
    n_hit = 0
    for _ in range(20):
        data.qpos[3:] = rng.normal(size=4)
        mujoco.mj_forward(model, data)
        start = np.column_stack([rng.uniform(-0.03, 0.03, (40, 2)), np.full(40, -0.1)])
        way = np.array([0.0, 0.0, 1.0])
        turn = data.geom_xmat[0].reshape(3, 3)
        found = entry(kind, size, (start - data.geom_xpos[0]) @ turn, turn.T @ way, hull)
        for place, at in zip(start, found, strict=True):
            true = mujoco.mj_ray(model, data, place, way, None, 1, -1, np.zeros(1, np.int32))
            assert at == pytest.approx(true if true >= 0 else np.inf, abs=2e-6)
            n_hit += true >= 0
    assert n_hit > 100


def test_a_plane_is_below_everywhere():
    hull = Hull(np.array([[0.0, 0.0, 1.0]]), np.zeros(1))
    np.testing.assert_allclose(hull.entry(np.array([[0.0, 0, 2], [1, 1, -3]]), np.array([0.0, 0, -1])), [2, -3])
