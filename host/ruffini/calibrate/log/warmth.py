"""How warm the sensor was while touches were collected: a calibration was tried in this range and nowhere else."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

CELSIUS = "temperatures_c"  # of a touch's facts: degrees by the place that the device names; absent: not measured

Ranges = dict[str, list[float]]


def celsius_ranges(touches: Iterable[dict[str, Any]]) -> Ranges | None:
    """Coldest and warmest by place over the facts of touches; None where no touch says any."""
    seen: dict[str, list[float]] = {}
    for facts in touches:
        for place, celsius in facts.get(CELSIUS, {}).items():
            seen.setdefault(place, []).append(float(celsius))
    return {place: [min(values), max(values)] for place, values in sorted(seen.items())} or None


def celsius_rows(ranges: Ranges | None) -> list[tuple[str, Any, Any]]:
    """Rows of a table: what, from, to."""
    if ranges is None:
        return [("temperature, C", "not measured", "")]
    return [(f"temperature of {place}, C", limits[0], limits[1]) for place, limits in ranges.items()]
