"""The field in a terminal: pressure as shades, shear as arrows, the wrench beside the truth."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
SHADES = " .:-=+*#%@"
ARROWS = "→↘↓↙←↖↑↗"  # y points down, as on the screen
REFRESH_S = 0.05


def field_text(force_n: Array, full_scale_n: float) -> list[str]:
    """One character per node pair: shear arrows where shear is strong, else shades of the normal force."""
    lines = []
    for row in force_n[::2]:
        text = ""
        for fx, fy, fz in row:
            shear = np.hypot(fx, fy)
            if shear > 0.25 * abs(fz) and shear > 0.05 * full_scale_n:
                text += ARROWS[int(np.round(np.arctan2(fy, fx) / (np.pi / 4))) % 8] + " "
            else:
                level = int(np.clip(-fz / full_scale_n, 0, 0.999) * len(SHADES))
                text += SHADES[level] * 2
        lines.append(text)
    return lines


class LiveField:
    """Redraws itself on a terminal, prints a line now and then elsewhere."""

    def __init__(self, title: str, *, quiet: bool = False) -> None:
        self._title = title
        self._full_scale = 1e-3
        self._last = 0.0
        self._live: Any = None
        self._count = 0
        if sys.stderr.isatty() and not quiet:
            from rich.console import Console
            from rich.live import Live

            self._live = Live(console=Console(stderr=True), refresh_per_second=20, transient=True)

    def __enter__(self) -> LiveField:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def show(self, force_n: Array | None, wrench: Array, truth: Array | None, flags: list[str]) -> None:
        """One more frame; `force_n` is None of a board without a field."""
        self._count += 1
        now = time.monotonic()
        lines = self._wrench_lines(wrench, truth, flags)
        if self._live is None:
            if self._count % 30 == 0:
                print("  ".join(lines), file=sys.stderr)
            return
        if now - self._last < REFRESH_S:
            return
        self._last = now
        from rich.text import Text

        field: list[str] = []
        if force_n is not None:
            self._full_scale = max(0.995 * self._full_scale, float(-force_n[..., 2].min()), 1e-3)
            field = field_text(force_n, self._full_scale)
        self._live.update(Text("\n".join([self._title, *field, *lines])))

    @staticmethod
    def _wrench_lines(wrench: Array, truth: Array | None, flags: list[str]) -> list[str]:
        lines = ["measured  F " + " ".join(f"{v:7.3f}" for v in wrench[:3]) + " N"]
        if truth is not None:
            lines.append("truth     F " + " ".join(f"{v:7.3f}" for v in truth[:3]) + " N (simulated)")
        return lines + ([" ".join(flags)] if flags else [])
