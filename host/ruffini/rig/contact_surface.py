"""Predicts the height of the next contact from earlier ones, to detect lost steps of the machine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.errors import RefusedError

Array = npt.NDArray[np.float64]

SAME_PLACE_M = 1e-6
MIN_CONTACTS = 9  # for a quadratic surface, which has six unknowns
CURVED_M = 1e-4  # deviation of a dome of 22 mm from a quadratic surface, 8 mm from its apex


class PadMovedError(RefusedError):
    """The pad is not at its known height: the machine lost steps, or the pad moved."""


class ContactSurface:
    """Heights of contacts; flat, tilted or gently curved in between."""

    def __init__(self) -> None:
        self._contacts: list[tuple[float, float, float]] = []

    def know(self, x_m: float, y_m: float, z_m: float) -> None:
        """Add a known contact."""
        self._contacts.append((x_m, y_m, z_m))

    def expected(self, x_m: float, y_m: float) -> float | None:
        """Predicted height of the contact at a position; None if the known contacts do not determine it."""
        before = self._before(x_m, y_m)
        if before is not None:
            return before
        if len(self._contacts) < MIN_CONTACTS:
            return None
        x, y, z = np.array(self._contacts).T
        scale = max(np.ptp(x), np.ptp(y), SAME_PLACE_M)
        terms, here = _terms(x / scale, y / scale), _terms(np.array([x_m / scale]), np.array([y_m / scale]))
        if np.linalg.matrix_rank(terms, tol=1e-2) < terms.shape[1] or not _is_within(x, y, x_m, y_m):
            return None
        return float((here @ np.linalg.lstsq(terms, z, rcond=None)[0])[0])

    def _before(self, x_m: float, y_m: float) -> float | None:
        for x, y, z in self._contacts:
            if np.hypot(x - x_m, y - y_m) < SAME_PLACE_M:
                return z
        return None

    def check(self, x_m: float, y_m: float, z_m: float, tolerance_m: float) -> None:
        """Check a new contact and add it.

        Raises
        ------
        PadMovedError
            Its height differs from the prediction by more than the tolerance.
        """
        known_m = self.expected(x_m, y_m)
        is_same = self._before(x_m, y_m) is not None
        if known_m is not None and abs(known_m - z_m) > tolerance_m + (0 if is_same else CURVED_M):
            told = f"before at {1e3 * known_m:.2f} mm" if is_same else f"by the others at {1e3 * known_m:.2f} mm"
            raise PadMovedError(f"the pad is touched at {1e3 * z_m:.2f} mm, {told}: "
                                "the machine lost steps or the pad moved: home it again")  # fmt: skip
        if not is_same:
            self.know(x_m, y_m, z_m)


def _terms(x: Array, y: Array) -> Array:
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def _is_within(x: Array, y: Array, x_m: float, y_m: float) -> bool:
    """True if a position lies among the others, not outside."""
    return bool(x.min() <= x_m <= x.max() and y.min() <= y_m <= y.max())
