"""The plan of a collection: reproducible, so that an interrupted collection can be continued."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ruffini.boards import Board
from ruffini.errors import InputError
from ruffini.rig import holder
from ruffini.rig.holder import UPRIGHT, Tilt
from ruffini.rig.log_file import ACTIVITY, TouchRecord
from ruffini.rig.placed_weight import MAX_GRAMS, SCALE_SIGMA_G
from ruffini.rig.units import GRAVITY_M_S2

HOLD_S = 0.5  # of a touch, at least
BORDER = 0.25  # of the window's half side stays untouched: there the camera sees a part of the dent only
NAMES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
# Table II of the F-TOUCH paper: signs of Fx Fy Fz Tx Ty Tz. The last is twisted both ways.
CONDITIONS = (
    (0, 0, -1, 0, -1, 0), (0, 0, -1, -1, -1, 0), (0, 0, -1, -1, 0, 0), (0, 0, -1, -1, 1, 0),
    (0, 0, -1, 0, 1, 0), (0, 0, -1, 1, 1, 0), (0, 0, -1, 1, 0, 0), (0, 0, -1, 1, -1, 0),
    (0, 1, 0, 1, 0, 0), (1, 1, 0, 1, -1, 0), (1, 0, 0, 0, -1, 0), (1, -1, 0, -1, -1, 0),
    (0, -1, 0, -1, 0, 0), (-1, -1, 0, -1, 1, 0), (-1, 0, 0, 0, 1, 0), (-1, 1, 0, 1, 1, 0),
    (0, 0, 0, 0, 0, 1), (0, 0, 0, 0, 0, -1),
)  # fmt: skip
MIN_COSINE = 0.8  # between the load that was asked for and the one that came
MIN_PART = 0.4  # of the load that was asked for
DRAWN_SHAPES = ("flat", "sphere", "square", "sphere", "triangle", "sphere")  # in turn: half of them are balls
DRAWN_RADIUS_M, DRAWN_SHORE_A = (4.2e-3, 5.5e-3), (20.0, 85.0)  # such that no press of 1.7 mm is above 15 N
SCALE = "scale"  # kind of a touch that a person holds while a kitchen scale is read
MAX_CHANGE = 0.15  # of a press that a person holds while the scale is read


class Touch(NamedTuple):
    """One press: place, depth below the contact, and how far the tip then goes sideways, metres."""

    x_m: float
    y_m: float
    depth_m: float
    shear_x_m: float = 0.0
    shear_y_m: float = 0.0
    hold_s: float = HOLD_S

    @property
    def kind(self) -> str:
        """What the log calls it."""
        return "press"

    def told(self) -> str:
        """For a person."""
        shear = f", sheared by {_mm(self.shear_x_m, self.shear_y_m)}" if self.shear_x_m or self.shear_y_m else ""
        return f"press at {_mm(self.x_m, self.y_m)}, {1e3 * self.depth_m:.2f} mm deep{shear}"

    def faults(self, record: TouchRecord) -> list[str]:
        """What only this kind of touch can get wrong."""
        return []


class Tool(NamedTuple):
    """An indenter: its shape, half its size, its hardness, and its name on a bench that has one."""

    shape: str
    radius_m: float
    shore_a: float
    name: str = ""

    def told(self) -> str:
        """For a person."""
        told = f"{self.shape} of {2e3 * self.radius_m:.1f} mm, Shore A {self.shore_a:.0f}"
        return f"{self.name} ({told})" if self.name else told


class Indent(NamedTuple):
    """A straight press of an indenter that is mounted for it: all of the way down counts."""

    tool: Tool
    x_m: float
    y_m: float
    depth_m: float
    hold_s: float = 0.0  # nothing is learned of standing still
    tilt_deg: Tilt = UPRIGHT  # of what is pressed

    @property
    def kind(self) -> str:
        return "indent"

    @property
    def press(self) -> Touch:
        """What the stage does once the indenter is mounted."""
        return Touch(self.x_m, self.y_m, self.depth_m, hold_s=self.hold_s)

    def told(self) -> str:
        turned = "" if self.tilt_deg == UPRIGHT else f", {holder.told(self.tilt_deg)}"
        return f"{self.tool.told()}, at {_mm(self.x_m, self.y_m)}, {1e3 * self.depth_m:.2f} mm deep{turned}"

    def faults(self, record: TouchRecord) -> list[str]:
        return []


class Weight(NamedTuple):
    """A weight that a person places."""

    x_m: float
    y_m: float
    grams: float

    @property
    def kind(self) -> str:
        return "weight"

    def told(self) -> str:
        return f"{self.grams:g} g at {_mm(self.x_m, self.y_m)}"

    def faults(self, record: TouchRecord) -> list[str]:
        return []


class ScalePress(NamedTuple):
    """A press by hand on a sensor that lies on a scale, held while the person types what the scale shows."""

    x_m: float
    y_m: float
    grams: float

    @property
    def kind(self) -> str:
        return SCALE

    def told(self) -> str:
        return f"press at {_mm(self.x_m, self.y_m)} until the scale shows about {self.grams:g} g"

    def faults(self, record: TouchRecord) -> list[str]:
        """The press changed between the typed reading and its end, as far as the markers or the force show it."""
        arrays, facts = record.arrays, record.facts
        seen = arrays.get(ACTIVITY)
        if seen is None:
            seen = np.linalg.norm(np.nan_to_num(arrays["stream_wrench"][:, :3]), axis=1)
        host_s = arrays["stream_host_s"]
        held = seen[(host_s > facts["held_host_s"]) & (host_s < facts["lifted_host_s"])]
        if not len(held) or not held.mean():
            return []
        change = float(np.ptp(held) / held.mean())
        return [f"the press changed by {100 * change:.0f} % while it was held"] if change > MAX_CHANGE else []


class HandTouch(NamedTuple):
    """A press by hand, as hard as is said."""

    x_m: float
    y_m: float
    force_n: float

    @property
    def kind(self) -> str:
        return "hand"

    def told(self) -> str:
        return f"press by hand at {_mm(self.x_m, self.y_m)} with {self.force_n:.2f} N"

    def faults(self, record: TouchRecord) -> list[str]:
        return []


class Condition(NamedTuple):
    """A load by hand through a rigid connector: which axes and which way, up to how much."""

    signs: tuple[int, ...]  # of Fx Fy Fz Tx Ty Tz
    force_n: float  # sideways
    torque_nm: float
    normal_n: float

    @property
    def kind(self) -> str:
        return "condition"

    def told(self) -> str:
        axes = " ".join(f"{'-+'[s > 0]}{name}" for s, name in zip(self.signs, NAMES, strict=True) if s)
        pressing = "" if self.normal_n == self.force_n else f", pressing {self.normal_n:g} N,"
        return f"load {axes}, up to {self.force_n:g} N{pressing} and {1e3 * self.torque_nm:g} N mm, then let go"

    def part(self, wrench: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Each axis of a load, (..., 6), over what is asked for."""
        return np.asarray(np.nan_to_num(wrench) / self.largest)

    @property
    def largest(self) -> npt.NDArray[np.float64]:
        """Of each axis, (6,) N and N m."""
        return np.array([self.force_n, self.force_n, self.normal_n, *[self.torque_nm] * 3])

    def faults(self, record: TouchRecord) -> list[str]:
        """Not this load: other axes, or too little of it."""
        parts = self.part(record.arrays["reference_wrench"])
        signs = np.array(self.signs, dtype=float)
        along = parts @ signs / np.linalg.norm(signs)
        peak = parts[along.argmax()]
        cosine = along.max() / max(float(np.linalg.norm(peak)), 1e-9)
        if cosine < MIN_COSINE:
            came = " ".join(f"{name} {p:+.2f}" for name, p in zip(NAMES, peak, strict=True))
            return [f"another load came than was asked for: {came}, in parts of the largest"]
        weak = abs(peak[signs != 0]).mean()
        return [f"only {100 * weak:.0f} % of the load that was asked for"] if weak < MIN_PART else []


Item = Touch | Indent | Weight | ScalePress | HandTouch | Condition


def _mm(x_m: float, y_m: float) -> str:
    return f"x {1e3 * x_m:+.1f}, y {1e3 * y_m:+.1f} mm"


class ByHand(NamedTuple):
    """What programs of a person go up to."""

    grams: tuple[float, ...] = (20.0, 50.0, 100.0, 200.0)
    force_n: float = 2.0
    torque_nm: float = 0.01
    normal_n: float | None = None  # of loads through a connector; None: as force_n


class Span(NamedTuple):
    """Where a program touches and how deep, metres; indenters and tilts of the bench, if it lists some."""

    half_x_m: float
    half_y_m: float
    deepest_m: float
    shear_m: float
    tools: tuple[Tool, ...] = ()
    tilts_deg: tuple[Tilt, ...] = ()

    @property
    def facts(self) -> dict[str, Any]:
        """What a log keeps of it: the plan follows from the lists of indenters and tilts."""
        tilts = {"tilts_deg": [list(tilt) for tilt in self.tilts_deg]} if self.tilts_deg else {}
        return {"indenters": [tool._asdict() for tool in self.tools], **tilts} if self.tools else {}

    def inside(self, part: float) -> Span:
        """The middle of it, so large a part along x and along y."""
        return self._replace(half_x_m=part * self.half_x_m, half_y_m=part * self.half_y_m)


def span_of(board: Board, deepest_m: float, shear_m: float, most_m: tuple[float, float] | None = None) -> Span:
    """The part of a board's pad that is touched: about its centre, well inside what the camera sees.

    most_m : no further from the centre than this, along x and y, the shear included.
    """
    pad, window = board.pad, board.window
    half_m = []
    for size_um, begin_um, end_um in (
        (pad.size_x_um, window.min_x_um, window.max_x_um), (pad.size_y_um, window.min_y_um, window.max_y_um)
    ):  # fmt: skip
        seen_um = min(size_um / 2 - begin_um, end_um - size_um / 2)
        # Beyond the window the gel goes on and is dented unseen, about as far from the contact as it is thick.
        unseen_um = pad.thickness_um if seen_um < size_um / 2 else 0
        half_m.append(1e-6 * max(min((1 - BORDER) * seen_um, seen_um - unseen_um), 0.0))
    if most_m is not None:
        half_m = [min(half, max(most - shear_m, 0.0)) for half, most in zip(half_m, most_m, strict=True)]
    return Span(half_m[0], half_m[1], deepest_m, shear_m)


def plan(program: str, span: Span, n: int, seed: int, by_hand: ByHand = ByHand()) -> list[Item]:  # noqa: B008
    """The touches of a program, one of `PROGRAMS`.

    Raises
    ------
    InputError
        No such program, or nothing to do.
    """
    items = PROGRAMS[program].items if program in PROGRAMS else None
    if items is None or n < 1:
        names = ", ".join(one.name for one in PROGRAMS.values() if one.items)
        raise InputError(f"program {program!r} with {n} touches: choose one of {names}, and one touch at least")
    return items(span, n, np.random.default_rng(seed), by_hand)


def check_weights(items: Sequence[Item], max_force_n: float) -> None:
    """Raises InputError if a person would be asked to press more than a limit allows."""
    heaviest = max(item.grams for item in items if isinstance(item, Weight | ScalePress))
    if (force_n := 1e-3 * heaviest * GRAVITY_M_S2) > max_force_n:
        raise InputError(f"grams: {heaviest:g} g is a press of {force_n:.1f} N, more than the {max_force_n:g} N of "
                         "max_force_n: give lighter weights")  # fmt: skip


def _grid(span: Span, n: int, rng: np.random.Generator) -> list[Touch]:
    n_x = max(1, round(np.sqrt(n * span.half_x_m / span.half_y_m)))
    n_y = -(-n // n_x)
    x = span.half_x_m * np.linspace(-1, 1, n_x) if n_x > 1 else np.zeros(1)
    y = span.half_y_m * np.linspace(-1, 1, n_y) if n_y > 1 else np.zeros(1)
    places = [(float(a), float(b)) for b in y for a in x][:n]
    levels = rng.permutation(np.linspace(0.4, 1.0, n))
    angles = rng.permutation(np.arange(n) * (2 * np.pi / n))
    way = np.where(np.arange(n) % 3 == 0, 0.0, span.shear_m)  # every third is straight
    return [
        Touch(*place, span.deepest_m * float(level), float(w * np.cos(a)), float(w * np.sin(a)))
        for place, level, a, w in zip(places, levels, angles, way, strict=True)
    ]


def spread(n: int, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """Points (n, 3) of the unit cube, evenly however many there are (a sequence of low discrepancy)."""
    steps = np.array([0.8191725134, 0.6710436067, 0.5497004779])
    return np.asarray((rng.uniform(size=3) + np.arange(n)[:, None] * steps) % 1)


def _balls(span: Span, n: int, rng: np.random.Generator) -> list[Touch]:
    return [
        Touch(
            float(span.half_x_m * (2 * a - 1)),
            float(span.half_y_m * (2 * b - 1)),
            float(span.deepest_m * (0.4 + 0.6 * c)),
        )
        for a, b, c in spread(n, rng)
    ]


def _straight(span: Span, n: int, rng: np.random.Generator, _: ByHand) -> list[Item]:
    """Places and depths spread over the pad, without shear."""
    return [*_balls(span, n, rng)]


def _sheared(span: Span, n: int, rng: np.random.Generator, _: ByHand) -> list[Item]:
    """Places in rows and columns, at each a depth and a shear of their own."""
    return [*_grid(span, n, rng)]


def _weights(
    kind: type[Weight | ScalePress], span: Span, n: int, rng: np.random.Generator, by_hand: ByHand
) -> list[Item]:
    """Each weight in turn, the places spread."""
    if not by_hand.grams or not all(0 < grams < MAX_GRAMS for grams in by_hand.grams):
        raise InputError(f"this program needs weights of more than 0 and less than {MAX_GRAMS:g} g: give "
                         "--grams, e.g. 20,50,100")  # fmt: skip
    balls = _balls(span, n, rng)
    return [kind(b.x_m, b.y_m, by_hand.grams[i % len(by_hand.grams)]) for i, b in enumerate(balls)]


def _free(span: Span, n: int, rng: np.random.Generator, by_hand: ByHand) -> list[Item]:
    """Places and forces spread."""
    return [HandTouch(b.x_m, b.y_m, by_hand.force_n * b.depth_m / span.deepest_m) for b in _balls(span, n, rng)]


def _conditions(_: Span, n: int, __: np.random.Generator, by_hand: ByHand) -> list[Item]:
    """The F-TOUCH paper's 17 (the twist both ways), again and again, until there are n."""
    normal_n = by_hand.normal_n or by_hand.force_n
    loads = [Condition(signs, by_hand.force_n, by_hand.torque_nm, normal_n) for signs in CONDITIONS]
    return [loads[i % len(loads)] for i in range(n)]


def _drawn(n: int, rng: np.random.Generator) -> list[Tool]:
    """Indenters of sizes and hardnesses spread over their ranges."""
    radius, shore = (rng.permutation(np.linspace(*ends, n)) for ends in (DRAWN_RADIUS_M, DRAWN_SHORE_A))
    # A seed of its own has sizes of its own, too.
    step = (DRAWN_RADIUS_M[1] - DRAWN_RADIUS_M[0]) / n
    radius = np.clip(radius + rng.uniform(-0.4, 0.4, n) * step, *DRAWN_RADIUS_M)
    shapes = (DRAWN_SHAPES[i % len(DRAWN_SHAPES)] for i in range(n))
    return [Tool(*one) for one in zip(shapes, radius.tolist(), shore.tolist(), strict=True)]


def setups_left_out(span: Span, n: int) -> str:
    """What so few touches leave out of the bench's indenters, each at all tilts; empty: nothing."""
    n_all = len(span.tools) * max(len(span.tilts_deg), 1)
    if n >= n_all:
        return ""
    return (
        f"{n} touches are for {n} of {n_all} setups ({len(span.tools)} indenters, each at all tilts): give --n {n_all}"
    )


def _indents(span: Span, n: int, rng: np.random.Generator, _: ByHand) -> list[Item]:
    """Places spread; the bench's indenters one after the other, each at all tilts; of the twin's bench drawn ones."""
    listed = [(tool, tilt) for tool in span.tools for tilt in span.tilts_deg or (UPRIGHT,)]
    setups = [listed[i * len(listed) // n] for i in range(n)] if listed else [(t, UPRIGHT) for t in _drawn(n, rng)]
    return [
        Indent(tool, float((2 * x - 1) * span.half_x_m), float((2 * y - 1) * span.half_y_m), span.deepest_m,
               tilt_deg=tilt)
        for (tool, tilt), (x, y, _) in zip(setups, spread(n, rng), strict=True)
    ]  # fmt: skip


@dataclass(frozen=True)
class Program:
    """What a collection presses, and what its bench is like.

    items : its plan; None: the person has one.
    n : touches, unless another number is asked for.
    is_by_stage : a machine moves the tip, and not a person.
    is_bolted : the reference is bolted to the sensor, and its drawing says where.
    is_of_scale : a person reads the reference off a kitchen scale under the sensor.
    is_of_csv : another program writes the reference.
    changes_tools : by indenters of many sizes and hardnesses, which a person mounts.
    weight_sigma_g : of the weights, where these are the reference themselves.
    reference_hz, frame_step : of a twin, where a press of it is long; None: its body's.
    """

    name: str
    items: Callable[[Span, int, np.random.Generator, ByHand], list[Item]] | None = None
    n: int = 20
    is_by_stage: bool = False
    is_bolted: bool = False
    is_of_scale: bool = False
    is_of_csv: bool = False
    changes_tools: bool = False
    weight_sigma_g: float | None = None
    reference_hz: float | None = None
    frame_step: int | None = None


PROGRAMS = {
    one.name: one
    for one in (
        Program("grid", _sheared, is_by_stage=True),
        Program("balls", _straight, is_by_stage=True),
        Program("weights", partial(_weights, Weight), weight_sigma_g=0.1),
        Program("scale", partial(_weights, ScalePress), is_of_scale=True, weight_sigma_g=SCALE_SIGMA_G),
        Program("free", _free),
        Program("conditions", _conditions, n=len(CONDITIONS), is_bolted=True),
        Program(
            "indenters", _indents, is_by_stage=True, is_bolted=True, changes_tools=True, reference_hz=0.8, frame_step=3
        ),  # long presses, and a soft body takes long to compute
        Program("log", is_of_csv=True),
    )
}
