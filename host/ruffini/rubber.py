"""What rubber of a hardness is made of."""

from __future__ import annotations

from ruffini.errors import InputError

RUBBER_POISSON = 0.48


def shore_a_modulus(shore_a: float) -> float:
    """Young's modulus (Pa) of a rubber of Shore A hardness S.

    E = 0.0981 (56 + 7.62336 S) / (0.137505 (254 - 2.54 S)) MPa: A. N. Gent, "On the relation between
    indentation hardness and Young's modulus", 1958. It takes the gauge's needle as a flat punch on a
    half-space, and is good to about a fifth between 20 and 80.

    Raises
    ------
    InputError
        S is not in 0 to 99.
    """
    if not 0 <= shore_a <= 99:
        raise InputError(f"Shore A hardness {shore_a:g} has no modulus: it must be 0 to 99")
    return 0.0981e6 * (56 + 7.62336 * shore_a) / (0.137505 * (254 - 2.54 * shore_a))
