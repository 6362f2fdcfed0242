"""Where the next contact must be, from those before: flat, tilted and curved pads, and lost steps."""

from __future__ import annotations

import numpy as np
import pytest

from ruffini.rig.contact_surface import ContactSurface, PadMovedError

TOLERANCE_M = 3e-4


def dome(x, y, radius_m=0.025):
    return np.sqrt(radius_m**2 - x**2 - y**2) - radius_m


def tilted(x, y):
    return 0.02 * x - 0.01 * y - 2e-4


def surface(shape, n: int) -> ContactSurface:
    rng = np.random.default_rng(1)
    made = ContactSurface()
    for x, y in [(-6e-3, -6e-3), (6e-3, 6e-3), *rng.uniform(-6e-3, 6e-3, (n, 2))]:
        made.check(x, y, shape(x, y) + rng.uniform(-1e-4, 1e-4), TOLERANCE_M)  # found in steps of 0.2 mm
    return made


@pytest.mark.parametrize("shape", [tilted, dome])
def test_height_is_foretold_from_enough_contacts(shape):
    assert surface(shape, 3).expected(1e-3, 2e-3) is None
    made = surface(shape, 18)
    assert made.expected(1e-3, 2e-3) == pytest.approx(shape(1e-3, 2e-3), abs=1.5e-4)
    assert made.expected(7e-3, 0) is None  # beyond the others it is a guess


@pytest.mark.parametrize("shape", [tilted, dome])
def test_a_machine_that_lost_steps_is_seen_at_a_new_place(shape):
    made = surface(shape, 18)
    with pytest.raises(PadMovedError, match=r"by the others at .* lost steps"):
        made.check(1e-3, 2e-3, shape(1e-3, 2e-3) - 6e-4, TOLERANCE_M)
    made.check(1e-3, 2e-3, shape(1e-3, 2e-3) + 1e-4, TOLERANCE_M)


def test_the_same_place_needs_no_others():
    made = ContactSurface()
    made.know(0, 0, -1e-4)
    assert made.expected(1e-8, 0) == -1e-4
    made.check(0, 0, -3e-4, TOLERANCE_M)
    with pytest.raises(PadMovedError, match=r"touched at -0\.60 mm, before at -0\.10 mm"):
        made.check(0, 0, -6e-4, TOLERANCE_M)


def test_contacts_in_a_row_do_not_make_a_surface():
    made = ContactSurface()
    for x in np.linspace(-5e-3, 5e-3, 12):
        made.know(x, 0.0, 0.0)
    assert made.expected(0.0011, 0.0) is None


# x, y and height, mm, of contacts of a ball on the twin of a skin: it gives way between its pyramids and at its seams.
SKIN = [
    (-59.9, -18.1, -0.5), (-105.4, 42.3, -0.3), (100.5, 12.7, -0.3), (55.1, -17.0, -0.3), (9.6, 43.4, -0.5),
    (-35.8, 13.8, -0.3), (-81.3, -15.8, -0.3), (124.6, 44.6, -0.7), (79.2, 15.0, -0.279), (33.7, -14.6, -0.251),
    (-11.7, -44.2, -0.3), (-57.2, 16.2, -0.464), (-102.6, -13.4, -0.309), (103.3, -43.0, -0.45),
]  # fmt: skip


def test_contacts_that_scatter_are_no_lost_steps_but_a_millimetre_is() -> None:
    made = ContactSurface()
    for x_mm, y_mm, z_mm in SKIN:
        made.check(1e-3 * x_mm, 1e-3 * y_mm, 1e-3 * z_mm, TOLERANCE_M)
    with pytest.raises(PadMovedError, match="by the others"):
        made.check(0.02, 0.01, -1.4e-3, TOLERANCE_M)
