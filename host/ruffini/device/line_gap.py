"""What was missed while a line was lost."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LineGap:
    """A time without line."""

    lost_s: float
    n_frames: int | None  # that were not received; None: the sensor was started again and counts from 0

    def __str__(self) -> str:
        missing = "it was started again" if self.n_frames is None else f"{self.n_frames} frames missing"
        return f"the line was lost for {self.lost_s:.2f} s: {missing}"

    def words(self) -> dict[str, str]:
        """The metadata record "gap" of a recording."""
        missing = "not known" if self.n_frames is None else str(self.n_frames)
        return {"lost_s": f"{self.lost_s:.3f}", "missing_frames": missing, "text": str(self)}
