"""What the benchmarks add to a true displacement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.ndimage import gaussian_filter

Array = npt.NDArray[np.float64]

WHITE_UM = (5.0, 5.0, 20.0)
HALF_WHITE_UM = (2.5, 2.5, 10.0)
CORRELATION_NODES = 3.0  # of the low-frequency noise, as a badly integrated depth has it


@dataclass(frozen=True)
class Disturbance:
    """What is added to the true displacement: white and correlated noise, micrometres (x, y, z).

    correlation_nodes : standard deviation s of the Gaussian filter that makes the latter, in node steps; nodes d steps
        apart then correlate by exp(-d^2 / (4 s^2))
    """

    white_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    correlated_um: tuple[float, float, float] = (0.0, 0.0, 0.0)
    correlation_nodes: float = CORRELATION_NODES

    def draw(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        out = rng.normal(size=shape) * np.array(self.white_um) * 1e-6
        rough = rng.normal(size=shape)
        smooth: Array = gaussian_filter(rough, (self.correlation_nodes, self.correlation_nodes, 0), mode="reflect")
        return np.asarray(out + smooth / np.std(smooth) * np.array(self.correlated_um) * 1e-6)
