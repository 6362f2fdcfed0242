"""A gel that relaxes: held presses, imprints, the same in recordings and live, at small and at finite strain."""

import dataclasses

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.sim.contact import ContactSolver, Indenter, Pose
from ruffini.sim.finite import FiniteMesh
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.programs import Rest, Touch
from ruffini.sim.prony import Prony
from ruffini.sim.recording import record_touches
from ruffini.sim.response import FiniteResponse, LinearResponse
from ruffini.sim.scenario import Scenario, scenario_of
from ruffini.sim.serve import Scripted, Steered
from ruffini.sim.settings import load_twin
from ruffini.sim.story import play

MM = 1e-3
BALL, HELD = Indenter("sphere", 3 * MM), Pose(0, 0, 0.6 * MM)
STORY = [Rest(1), Touch(BALL, [HELD] * 30, [True] * 30), Rest(12)]


@pytest.fixture(scope="module")
def unit(coarse_unit):
    return dataclasses.replace(coarse_unit, twin=coarse_unit.twin.with_pad(is_relaxing=True))


@pytest.fixture(scope="module")
def moments(unit):
    return [(m.wrench()[2], m.displacement.copy(), m.nodal_displacement()) for m in play(unit, STORY)]


def test_a_held_force_falls_with_the_series(unit, moments):
    """Without a change of shape all stress is elastic stress times g; the first frame is itself a ramp."""
    series = unit.twin.pad.prony()
    assert 0.2 <= series.loss <= 0.3
    force = np.array([wrench for wrench, _, _ in moments])[1:31]
    time_s = np.arange(30) * unit.frame_s
    expected = [np.mean([series.part(t + part * unit.frame_s) for part in np.linspace(0, 1, 101)]) for t in time_s]
    np.testing.assert_allclose(force / force[0], expected / expected[0], rtol=2e-3)
    assert force[-1] / force[0] < 0.92


def test_an_imprint_stays_and_fades(unit, moments):
    depth = [-displacement[:, 2].min() for _, displacement, _ in moments[31:]]
    assert 0.01 * MM < depth[-1] < depth[0] < 0.2 * MM
    assert not any(wrench for wrench, _, _ in moments[31:])
    np.testing.assert_allclose(-moments[31][2][..., 2].min(), depth[0], rtol=0.05)  # the truth tells of it
    rig = unit.rig()
    rig.take(BALL)
    rig.advance(HELD)
    for _ in range(3000):
        rig.rest()
    assert np.abs(rig.displacement).max() < 0.01e-6 + 0.02 * depth[0]


def test_recordings_and_the_live_twin_relax_alike(unit, tmp_path, moments):
    record_touches(unit, STORY, tmp_path / "out", seed=1, program="test")
    truth = np.load(tmp_path / "out" / "truth.npz")
    np.testing.assert_array_equal(truth["wrench"][:, 2], [wrench for wrench, _, _ in moments])
    text = (tmp_path / "out" / "recording.toml").read_text()
    assert "is_relaxing = true" in text
    live = Scripted(unit, scenario_of({"program": "press"}, "test"))
    again = Scripted(unit, scenario_of({"program": "press"}, "test"))
    assert all((live.states(i)[0] == again.states(i)[0]).all() for i in range(len(live)))


def test_a_steered_indenter_that_stands_still_feels_it(unit):
    steered = Steered(unit, BALL)
    steered.move_to(Pose(0, 0, 0.3 * MM))
    force = []
    for frame in range(20):
        steered.states(frame)
        force.append(steered.wrench[2])
    assert (np.diff(force) > 0).all()  # there after one frame, it presses less and less
    assert 0.8 < force[-1] / force[0] < 0.95


def test_finite_strain_relaxes_like_the_linear_pad_where_strain_is_small():
    model = PadModel(8 * MM, 6 * MM, 3 * MM, 2e5, 0.45, n_cells_x=6, n_cells_y=6, layers=(0.4, 0.6))
    series, ball = Prony(((0.15, 0.1), (0.1, 1.0))), Indenter("sphere", 900 * MM)
    forces = []
    for response in (FiniteResponse(FiniteMesh(model), series), LinearResponse(surface_compliance(model), series)):
        solver = ContactSolver(model, response, ball, 0.6)
        history = []
        for depth, duration_s in ((2e-6, 0.05), (2e-6, 0.5), (1.5e-6, 0.01), (2e-6, 5.0)):
            solver.advance(Pose(0, 0, depth), duration_s)
            history.append(solver.nodal_force.sum(axis=0)[2])
        forces.append(history)
    np.testing.assert_allclose(forces[0], forces[1], rtol=3e-3)


def test_a_scenario_chooses_the_pad():
    board = find_board("gelslim")
    twin = Scenario(strain="finite", is_relaxing=True).twin(board)
    assert (twin.pad.strain, twin.pad.is_relaxing) == ("finite", True)
    assert Scenario().twin(board) == load_twin(board)
    with pytest.raises(InputError, match="relax_1e3"):
        Scenario(is_relaxing=True).twin(find_board("eltac"))
