"""Predicts the height of the next contact from earlier ones, to detect lost steps of the machine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.errors import RefusedError

Array = npt.NDArray[np.float64]

SAME_PLACE_M = 1e-6
MIN_CONTACTS = 9  # for a quadratic surface, which has six unknowns
SIGMAS = 3.0  # of a prediction: a skin on pyramids is softer between them, so that its contacts scatter by 0.2 mm
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
        predicted = self._predicted(x_m, y_m)
        return None if predicted is None else predicted[0]

    def _predicted(self, x_m: float, y_m: float) -> tuple[float, float] | None:
        """Height of the contact, and by how much it may be off: nothing where it is known."""
        before = self._before(x_m, y_m)
        if before is not None:
            return before, 0.0
        if len(self._contacts) < MIN_CONTACTS:
            return None
        x, y, z = np.array(self._contacts).T
        scale = max(np.ptp(x), np.ptp(y), SAME_PLACE_M)
        terms, here = _terms(x / scale, y / scale), _terms(np.array([x_m / scale]), np.array([y_m / scale]))
        if np.linalg.matrix_rank(terms, tol=1e-2) < terms.shape[1] or not _is_within(x, y, x_m, y_m):
            return None
        fit = np.linalg.lstsq(terms, z, rcond=None)[0]
        variance = np.sum((z - terms @ fit) ** 2) / (len(z) - len(fit))
        leverage = here @ np.linalg.inv(terms.T @ terms) @ here.T
        return float((here @ fit)[0]), CURVED_M + SIGMAS * float(np.sqrt(variance * (1 + leverage[0, 0])))

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
        predicted, is_same = self._predicted(x_m, y_m), self._before(x_m, y_m) is not None
        if predicted is not None and abs(predicted[0] - z_m) > tolerance_m + predicted[1]:
            known_m = predicted[0]
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
