"""Renderers of every board with a twin, and dents without any mechanics."""

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.sim.optics.charts import chart_of
from ruffini.sim.optics.renderer import Renderer
from ruffini.sim.settings import TwinSettings, load_twin


class Bench:
    """A renderer over its whole chart; `dent` is a Gaussian push inwards, millimetres."""

    def __init__(self, name, **changes):
        self.board = find_board(name)
        tree = load_twin(self.board).model_dump(by_alias=True)
        for section, values in changes.items():
            tree[section] = values
        self.twin = TwinSettings.model_validate(tree)
        self.chart = chart_of(self.twin.shape)
        half_a, half_b = self.chart.half_size(self.board.pad)
        self.a, self.b = np.meshgrid(np.linspace(-half_a, half_a, 65), np.linspace(-half_b, half_b, 49))
        self.renderer = Renderer(self.board, self.twin, self.a[0], self.b[:, 0])

    def rest(self):
        return np.zeros((*self.a.shape, 3))

    def shifted(self, *shift_mm):
        return self.rest() + np.array(shift_mm) * 1e-3

    def dent(self, a, b, depth, width):
        place = self.chart.points(self.a.astype(np.float32), self.b.astype(np.float32)).astype(float)
        inward = {
            "plane": np.broadcast_to([0.0, 0.0, -1.0], place.shape),
            "tube": place * [-1, -1, 0],
            "dome": np.array([0, 0, -self.twin.shape.radius_um * 1e-3]) - place,
        }[self.twin.shape.kind]
        inward = inward / np.linalg.norm(inward, axis=-1, keepdims=True)
        push = depth * np.exp(-((self.a - a) ** 2 + (self.b - b) ** 2) / (2 * width**2))
        return push[..., None] * inward * 1e-3

    def picture(self, displacement=None, seed=1, **more):
        displacement = self.rest() if displacement is None else displacement
        return self.renderer.image(displacement, np.random.default_rng(seed), **more).astype(float)


@pytest.fixture(scope="session")
def bench():
    made = {}

    def get(name, **changes):
        key = (name, repr(changes))
        if key not in made:
            made[key] = Bench(name, **changes)
        return made[key]

    return get
