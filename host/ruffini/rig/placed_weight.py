"""The simplest reference: a weight that a person places on the level pad."""

from __future__ import annotations

import re

from ruffini import host_clock
from ruffini.errors import InputError
from ruffini.rig.reference import Facts, Reading, pressing
from ruffini.rig.units import GRAVITY_M_S2

NAME = "placed weight"
SCALE_SIGMA_G = 2.0  # of a kitchen scale: its last digit, and how much a hand changes while it is read
MAX_GRAMS = 20000.0
GRAMS = re.compile(r"\s*(\d{1,5}(?:[.,]\d{1,4})?)\s*g?\s*", re.ASCII)
MAX_SHOWN = 20  # characters of what was typed
PAUSE_S = 0.05
RATE_HZ = 0.5 / PAUSE_S  # stated: a busy computer, or a twin's clock of 10 Hz, keeps no more


def grams_of(text: str) -> float:
    """Grams as a person types them, with a decimal point or a decimal comma.

    Raises
    ------
    InputError
        It is no weight.

    Examples
    --------
    >>> grams_of("203,5 g")
    203.5
    """
    found = GRAMS.fullmatch(text)
    if found is None:
        raise InputError(f"{text[:MAX_SHOWN]!r} is no weight in grams: type what the scale shows, such as 203 or 203.5")
    return float(found[1].replace(",", "."))


class PlacedWeight:
    """Reads zero until `place(grams)` puts a weight on the pad; `place(0)` removes it."""

    def __init__(self, sigma_grams: float, *, gravity_m_s2: float = GRAVITY_M_S2) -> None:
        if not 0 < sigma_grams < MAX_GRAMS:
            raise InputError(
                f"{sigma_grams:g} g is no uncertainty of a weight: weigh it on a scale, and give its error"
            )
        self._gravity, self._grams = gravity_m_s2, 0.0
        to_n = 1e-3 * gravity_m_s2
        self.facts = Facts.of_one_axis(NAME, MAX_GRAMS * to_n, sigma_grams * to_n, RATE_HZ, "g", is_typed=True)

    def place(self, grams: float) -> None:
        """From now on this weight is on the pad."""
        if not 0 <= grams < MAX_GRAMS:
            raise InputError(f"{grams:g} g is no weight for a pad: give grams, 0 to {MAX_GRAMS:g}")
        self._grams = grams

    def read(self, timeout_s: float) -> list[Reading]:
        host_clock.sleep(min(PAUSE_S, timeout_s))
        return [Reading(host_clock.now(), pressing(-1e-3 * self._gravity * self._grams))]

    def close(self) -> None:
        self._grams = 0.0
