"""Units of force, and a reference that stands turned beside the pad, against figures by hand."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.errors import InputError
from ruffini.rig.turned import Turned, turn_of
from ruffini.rig.units import force_factor


@pytest.mark.parametrize(
    ("unit", "newtons"),
    [
        ("N", 1.0),
        (" kN ", 1e3),
        ("gf", 9.80665e-3),
        ("g", 9.80665e-3),
        ("oz", 0.2780138509537812),
        ("ozf", 0.2780138509537812),
    ],
)
def test_a_unit_in_newtons(unit: str, newtons: float) -> None:
    assert force_factor(unit) == pytest.approx(newtons, rel=1e-12)


def test_axes_that_are_mirrored_are_refused() -> None:
    with pytest.raises(InputError, match="right-handed"):
        turn_of(("+x", "+y", "-z"))


def test_an_inverted_reference_changes_the_sign_of_every_axis() -> None:
    np.testing.assert_array_equal(turn_of(("+x", "+y", "+z"), is_inverted=True), -np.eye(3))


def test_force_and_torque_are_turned_and_carried_to_the_pad() -> None:
    """A force of 1 N along the reference's x is the pad's y; 0.1 m along x, its torque about z is 0.1 N m less."""

    turned = Turned.__new__(Turned)
    turned._matrix, turned._arm_m = turn_of(("-y", "+x", "+z")), np.array([0.1, 0.0, 0.0])
    carried = turned._carried(np.array([1.0, 0.0, 0.0, 0.5, 0.0, 0.25]))
    np.testing.assert_allclose(carried, [0.0, 1.0, 0.0, 0.0, 0.5, 0.25 - 0.1], atol=1e-12)
