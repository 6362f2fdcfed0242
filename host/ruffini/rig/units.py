"""Units of force and torque as devices name them, and what a wrong one looks like."""

from __future__ import annotations

from ruffini.errors import InputError

GRAVITY_M_S2 = 9.80665  # standard; on Earth 9.78 to 9.83
POUND_N = 4.4482216152605
NEWTONS = {
    "n": 1.0, "mn": 1e-3, "kn": 1e3,
    "g": 1e-3 * GRAVITY_M_S2, "gf": 1e-3 * GRAVITY_M_S2, "kg": GRAVITY_M_S2, "kgf": GRAVITY_M_S2,
    "lb": POUND_N, "lbf": POUND_N, "klbf": 1e3 * POUND_N, "oz": POUND_N / 16, "ozf": POUND_N / 16,
}  # fmt: skip
NEWTON_METRES = {
    "nm": 1.0, "n-m": 1.0, "nmm": 1e-3, "n-mm": 1e-3, "kn-m": 1e3,
    "lbf-in": POUND_N * 0.0254, "lbf-ft": POUND_N * 0.3048, "kgf-cm": GRAVITY_M_S2 * 1e-2,
}  # fmt: skip
MISTAKES = {"N": 1.0, "g": NEWTONS["g"], "kg": GRAVITY_M_S2, "lb": POUND_N, "oz": NEWTONS["oz"], "mN": 1e-3}
MISTAKE_TOLERANCE = 0.03  # of the ratio that a wrong unit makes


def force_factor(unit: str) -> float:
    """Newtons in one of `unit`.

    Raises
    ------
    InputError
        No unit of force that is known.
    """
    return _factor(unit, NEWTONS, "force")


def torque_factor(unit: str) -> float:
    """Newton metres in one of `unit`; raises InputError as `force_factor`."""
    return _factor(unit, NEWTON_METRES, "torque")


def _factor(unit: str, known: dict[str, float], what: str) -> float:
    factor = known.get(unit.strip().lower().replace(" ", "").replace("·", ""))
    if factor is None:
        raise InputError(f"{unit!r} is no unit of {what} that is known: use one of {', '.join(known)}")
    return factor


def likely_mistake(
    measured_n: float, expected_n: float, stated_unit: str, tolerance: float = MISTAKE_TOLERANCE
) -> str | None:
    """Unit that a reference seems to count in, where `measured_n` is off `expected_n` by just the ratio of two units.

    `stated_unit` is what it was said to count in; None where no other unit explains the difference.
    """
    if measured_n <= 0 or expected_n <= 0:
        return None
    true_factor = force_factor(stated_unit) * expected_n / measured_n
    if abs(true_factor / force_factor(stated_unit) - 1) <= tolerance:
        return None
    for unit, factor in MISTAKES.items():
        if abs(true_factor / factor - 1) <= tolerance:
            return unit
    return None
