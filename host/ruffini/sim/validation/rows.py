"""One comparison of the validation table."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Row:
    """Theory beside the twin. `tolerance` is of the theory's size, or of `scale` where theory says zero."""

    check: str
    quantity: str
    theory: float
    twin: float
    unit: str
    tolerance: float
    scale: float | None = None

    @property
    def error(self) -> float:
        """Difference over theory, or over `scale`."""
        return (self.twin - self.theory) / (abs(self.theory) if self.scale is None else self.scale)

    @property
    def is_good(self) -> bool:
        """Within the tolerance; never where a number is none."""
        return bool(abs(self.error) <= self.tolerance)


@dataclass(frozen=True)
class Curve:
    """What a picture shows of a check: lines of theory, points of the twin."""

    title: str
    x_label: str
    y_label: str
    theory: tuple[Array, Array]
    twin: tuple[Array, Array]


@dataclass
class Outcome:
    """Rows and curves of some checks."""

    rows: list[Row] = field(default_factory=list)
    curves: list[Curve] = field(default_factory=list)
