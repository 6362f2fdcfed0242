"""The pad's memory: firmware/solve/relaxation.h, on Python's unbounded integers."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from mirror.block_float import shifted
from mirror.fixed import I64, Saturations

ONE = 1 << 30
WHOLE = 1 << 20
MAX_FORCE = 1 << 25
LONGEST = 24


def relaxed_part(duration_us: int, time_us: int) -> int:
    """1 - exp(-duration / time), Q20."""
    if duration_us >= LONGEST * time_us:
        return WHOLE
    x = (duration_us << 30) // time_us
    halvings = 0
    while x >> halvings > ONE // 8:
        halvings += 1
    z = x >> halvings
    e = ONE - z // 5
    for n in (4, 3, 2, 1):
        e = ONE - shifted(z * e, 30) // n
    for _ in range(halvings):
        e = shifted(e * e, 30)
    return shifted(ONE - e, 10)


class Relaxation:
    def __init__(self, part_q20: npt.NDArray[np.int32], time_ms: npt.NDArray[np.int32], n_nodes: int) -> None:
        self.terms = [(int(g), 1000 * int(t)) for g, t in zip(part_q20, time_ms, strict=True)]
        self.state = [[0] * (3 * n_nodes) for _ in self.terms]
        self.before = [0] * (3 * n_nodes)
        self.last_us = 0

    def run(self, capture_us: int, mask: I64, force: I64, saturations: Saturations) -> I64:
        """Real force of the elastic one, both (n_nodes, 3) in force steps."""
        duration = 0 if self.last_us == 0 else max(capture_us - self.last_us, 0)
        self.last_us = max(capture_us, self.last_us)
        step = [relaxed_part(duration, time) for _, time in self.terms]
        touched = np.repeat(mask.ravel() > 0, 3)
        out = [0] * force.size
        for i, f in enumerate(saturations.clamp(force.ravel(), -MAX_FORCE, MAX_FORCE).tolist()):
            dent = sum(shifted(h[i] * g, 20) for h, (g, _) in zip(self.state, self.terms, strict=True))
            elastic = f << 16 if touched[i] else dent
            mean = shifted(elastic + self.before[i], 1)
            self.before[i] = elastic
            lost = 0
            for h, (g, _), s in zip(self.state, self.terms, step, strict=True):
                h[i] += shifted((mean - h[i]) * s, 20)
                lost += shifted(h[i] * g, 20)
            out[i] = shifted(elastic - lost, 16) if touched[i] else 0
        return np.array(out, np.int64).reshape(force.shape)
