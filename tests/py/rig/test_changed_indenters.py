"""Presses of indenters that are changed: put on with the tip up, each with a contact height of its own."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from ruffini.errors import InputError, RefusedError
from ruffini.rig.bench import Bench
from ruffini.rig.collect import _by_indenter
from ruffini.rig.guarded_stage import DryStage, GuardedStage, Limits
from ruffini.rig.program import Indent, Tool
from ruffini.rig.stage import Place

LIMITS = Limits(0.006, 0.006, 0.003, -0.003, 0.002, 20.0)
FLAT, SOFT = Tool("flat", 5e-3, 80.0), Tool("sphere", 5e-3, 20.0)


class Asked:
    """A person who notes what they are told."""

    def __init__(self, *, is_there: bool = True) -> None:
        self.told: list[str] = []
        self.is_there = is_there

    def say(self, text: str) -> None:
        self.told.append(text)

    def confirm(self, text: str) -> None:
        self.told.append(text)
        if not self.is_there:
            raise RefusedError("nobody answers")


class QuietBench(Bench):
    """Without reference and stream."""

    def hold(self, started_s: float, least_s: float = 0.0) -> float:
        return started_s

    def rest(self) -> list[Any]:
        return []


class Pressed:
    """A stage over a pad that a soft indenter has to sink into before it is felt."""

    def __init__(self) -> None:
        self.dry, self.felt_m, self.heights = DryStage(Place(0.0, 0.0, LIMITS.top_m)), 0.0, list[float]()

    def force(self) -> np.ndarray:
        return np.array([0.0, 0.0, -1.0 * (self.dry.position().z_m < -self.felt_m)])

    def put_on(self, tool: Tool) -> None:
        self.heights.append(self.dry.position().z_m)
        self.felt_m = 5e-4 if tool == SOFT else 0.0


def test_each_is_put_on_with_the_tip_up_and_meets_the_pad_where_it_does():
    pressed = Pressed()
    stage = GuardedStage(pressed.dry, Place(0.0, 0.0, 0.0), LIMITS, pressed.force)
    bench: Any = QuietBench(None, None, {}, Asked(), 20.0, stage, mount=pressed.put_on)  # type: ignore[arg-type]
    path: list[tuple[float, Place]] = []
    hard, soft, again = (_by_indenter(bench, Indent(tool, 1e-3, 0.0, 1e-3), path) for tool in (FLAT, SOFT, FLAT))
    assert pressed.heights == [LIMITS.top_m] * 3
    assert hard["contact_z_m"] - soft["contact_z_m"] == pytest.approx(5e-4, abs=1.1e-4)  # no lost steps
    assert again["contact_z_m"] == hard["contact_z_m"]
    assert hard["tool"] == {"shape": "flat", "radius_m": 5e-3, "shore_a": 80.0}
    assert hard["held_host_s"] == hard["touched_host_s"]  # all of the way down counts
    assert min(place.z_m for _, place in path) == pytest.approx(soft["contact_z_m"] - 1e-3)


def test_a_person_is_asked_where_nothing_puts_it_on():
    person = Asked()
    bench: Any = QuietBench(None, None, {}, person, 20.0)  # type: ignore[arg-type]
    bench.put_on(FLAT)
    assert person.told == ["put on: flat of 5.0 mm, Shore A 80"]
    person.is_there = False
    with pytest.raises(RefusedError, match="nobody"):
        bench.put_on(SOFT)
    with pytest.raises(InputError, match="stage"):
        _by_indenter(bench, Indent(FLAT, 0.0, 0.0, 1e-3), [])
