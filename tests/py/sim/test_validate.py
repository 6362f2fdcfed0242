"""The validation table: its theory against published numbers, its twin within tolerance, its exit code."""

import json

import numpy as np
import pytest
from kept import kept
from typer.testing import CliRunner

from ruffini.cli.app import app
from ruffini.sim.bodies.pyramid import PyramidLaw
from ruffini.sim.bodies.shell import Shell
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.validation import contacts, platforms, shells, skins, solids, table
from ruffini.sim.validation.block import Block
from ruffini.sim.validation.layer import BondedLayer
from ruffini.sim.validation.rows import Outcome, Row


@pytest.fixture(scope="module")
def outcome():
    return kept(table.validate, quick=True)


def test_every_number_is_within_its_tolerance(outcome):
    assert len(outcome.rows) == 35
    assert [row for row in outcome.rows if not row.is_good] == []
    assert max(row.tolerance for row in outcome.rows) <= 0.05


def test_table_and_picture(outcome, tmp_path):
    result = json.loads(json.dumps(table.as_dict(outcome)))
    assert result["good"] is True
    assert {"check", "quantity", "theory", "twin", "error", "tolerance"} <= set(result["rows"][0])
    assert "35 numbers, all within" in table.as_text(outcome)
    table.picture(outcome, tmp_path / "new" / "table.png")
    assert (tmp_path / "new" / "table.png").stat().st_size > 10_000


def test_a_number_outside_is_exit_code_1(monkeypatch):
    bad = Outcome(
        rows=[
            Row("a", "b", 1.0, 1.04, "N", 0.03),
            Row("a", "c", 0.0, 0.0, "N", 0.03, scale=1.0),
        ]
    )
    monkeypatch.setattr(table, "validate", lambda **_: bad)
    done = CliRunner().invoke(app, ["bench", "mechanics"])
    assert done.exit_code == 1
    assert "OUTSIDE" in done.stdout
    assert "2 numbers, 1 outside" in done.stdout


def test_a_wrong_twin_is_noticed(monkeypatch):
    """A pad 5 % too stiff is outside; so is a number that is none."""
    monkeypatch.setattr(contacts, "surface_compliance", lambda model: surface_compliance(model) / 1.05)
    out = Outcome()
    contacts.thin_layer(out)
    assert not any(row.is_good for row in out.rows)
    assert not Row("a", "b", 1.0, float("nan"), "N", 0.03).is_good


def test_a_dome_of_stiffer_rubber_is_noticed(monkeypatch):
    right = shells.DomeModel
    monkeypatch.setattr(
        shells,
        "DomeModel",
        lambda r, t, modulus, nu, n: right(r, t, 1.08 * modulus, nu, n),
    )
    out = Outcome()
    shells.run(out)
    assert len(out.rows) == 4
    assert not any(row.is_good for row in out.rows)


def test_another_tray_is_noticed(monkeypatch):
    """Springs of thicker wire, 2 %; a ring 1 % wider is felt in the turns alone."""
    right = platforms.TRAY
    for change, n_bad in (({"wire_um": 510}, 4), ({"ring_um": 13130}, 3)):
        monkeypatch.setattr(platforms, "TRAY", right.model_copy(update=change))
        out = Outcome()
        platforms.tray(out)
        assert [row.is_good for row in out.rows].count(False) == n_bad


def test_another_pyramid_or_panel_is_noticed(monkeypatch):
    monkeypatch.setattr(skins, "PyramidLaw", lambda base, height, e: PyramidLaw(base, height, 1.02 * e))
    monkeypatch.setattr(
        skins,
        "Shell",
        lambda patch, rest, t, e, nu: Shell(patch, rest, 1.05 * t, e, nu),
    )
    out = Outcome()
    skins.run(out)
    assert len(out.rows) == 4
    assert not any(row.is_good for row in out.rows)


@pytest.mark.parametrize(("poisson", "coefficient"), [(0.5, 1.133), (0.3, 0.881)])
def test_the_bed_makes_what_dimitriadis_says(poisson, coefficient):
    """F = F_Hertz (1 + c chi + ...), chi = sqrt(R d)/h: 1.133 at 0.5 (their eq. 13), by their eq. 11 elsewhere."""
    layer = BondedLayer(1.0, 1.0, min(poisson, 0.4999))
    radius, depth = 1.0, 1e-4  # chi = 0.01
    load, _ = layer.hertz(radius, depth)
    ratio = load / (4 / 3 * layer.plane_pa * radius**0.5 * depth**1.5)
    assert (ratio - 1) / 0.01 == pytest.approx(coefficient, rel=0.03)


def test_waves_see_the_half_space_or_the_confined_layer():
    layer = BondedLayer(2e-3, 2e5, 0.4)
    for k in (8.0 / 2e-3, 20.0 / 2e-3):
        normal, along, across = layer.wave_compliance(k)
        np.testing.assert_allclose([normal, along], 0.6 / (layer.shear_pa * k), rtol=2e-3)
        assert across == pytest.approx(1 / (layer.shear_pa * k), rel=1e-3)
    normal, along, across = layer.wave_compliance(1e-3 / 2e-3)
    assert normal == pytest.approx(2e-3 / layer.confined_pa, rel=1e-4)
    np.testing.assert_allclose([along, across], 2e-3 / layer.shear_pa, rtol=1e-4)


def test_the_block_is_the_linear_pad_under_little_load():
    block = Block(4e-3, 2e-3, 2e-3, 2e5, 0.3)
    model = PadModel(8e-3, 8e-3, 2e-3, 2e5, 0.3, 12, 12, layers=(0.3, 0.7))
    force = solids.patch_load(model, 60.0)
    u = (surface_compliance(model) @ force.ravel()).reshape(-1, 3)
    assert block.centre_depth(60.0, 4) == pytest.approx(-u[len(u) // 2, 2], rel=0.02)
