"""Whether a calibration is good enough to be flashed: each gate a number, a limit and a sentence.

Each estimator states its own, judged by touch, each touch by a fit that did not see it, and on the board's own
integers. They travel in the file's manifest, so that `ruffini cal flash` can refuse a file wherever it comes from.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ruffini.calibrate.container import FAILED, PASSED, CalibrationFile
from ruffini.errors import RefusedError
from ruffini.files import readable

MIN_PRESSES = 10  # without a fleet or a previous calibration behind it
MIN_COVERAGE = 0.5  # of CELLS x CELLS parts of the window: what was never pressed is not calibrated
MAX_ERROR = 0.05  # of the largest force: 95th percentile of touches left out; the main job's own limit
MAX_REST_N = 0.02  # force of an untouched frame, 99th percentile
MAX_WRENCH_ERROR = 0.10  # of what an axis was loaded with: RMS on what was left out
# What a person presses again if a gate fails; of the others only the gate's own text helps.
REMEDIES = {
    "touches": "press more",
    "places": "press more, at the places of the rings",
    "coverage": "press more, at the places of the rings: each needs a touch near it",
    "interval of E": "press more, and harder",
    "error": "press again: straight down, without sliding, and type the number once it stands still",
    "gain": "press again: set the scale to zero first, and type the number once it stands still",
    "on the board": "press again: straight down, without sliding, and type the number once it stands still",
    "modulus": "begin again: is the scale in grams, and is it this board's pad?",
    "normals": "press more: with a clean ball, in steady light; is its diameter right?",
    "depth": "press more: with a clean ball, in steady light; is its diameter right?",
    "scale": "begin again: is the ball's diameter right?",
    "rest": "begin again: in steady light, with nothing on the pad while rest is learned",
    "against the previous": "press more; until then what is in force stays",
}
HARD_N = 2.0  # below, a skin's force is judged in newtons by what the calibration states, not as a part


class Gate(NamedTuple):
    """One condition; `ok` is None where it could not be judged (it does not refuse then).

    stage : name of the estimator that states it; empty for conditions on the log or on the whole file.
    """

    name: str
    ok: bool | None
    value: float | None
    limit: float | None
    text: str
    stage: str = ""


def at_most(name: str, value: float, limit: float, what: str) -> Gate:
    return Gate(name, bool(value <= limit), value, limit, f"{value:.3g} {what}, at most {limit:.3g}")


def at_least(name: str, value: float, limit: float, what: str) -> Gate:
    return Gate(name, bool(value >= limit), value, limit, f"{value:.3g} {what}, at least {limit:.3g}")


def part(name: str, value: float, limit: float, what: str) -> Gate:
    """At most so large a part, said in per cent."""
    return Gate(name, bool(value <= limit), value, limit, f"{100 * value:.2g} % {what}, at most {100 * limit:.3g} %")


def covered(value: float, what: str) -> Gate:
    return Gate("coverage", bool(value >= MIN_COVERAGE), value, MIN_COVERAGE,
                f"{100 * value:.0f} % {what} pressed, at least {100 * MIN_COVERAGE:.0f} %")  # fmt: skip


def near(name: str, value: float, factor: float, what: str) -> Gate:
    """Within a factor of 1, either way."""
    return Gate(name, bool(1 / factor <= value <= factor), value, factor,
                f"{value:.3g} times that {what}, from {1 / factor:.2g} to {factor:.3g} times")  # fmt: skip


def gates_of_reference(of_logs: list[dict[str, Any]]) -> list[Gate]:
    """What `cal collect` checked of the reference; `of_logs`: the `found` of each."""
    gates = []
    for found in of_logs:
        for name, check in found.get("checks", {}).items():
            if isinstance(check, dict) and "ok" in check:
                gates.append(Gate(f"reference {name}", check["ok"], None, None, str(check.get("text", ""))))
    return gates


def failed(gates: Sequence[Gate]) -> list[Gate]:
    """Those that refuse."""
    return [gate for gate in gates if gate.ok is False]


def need_passed(gates: Sequence[Gate], page: Path, *, force: bool) -> bool:
    """True if none refuses. Raises RefusedError if one does and `force` is not given; `page` shows why."""
    bad = failed(gates)
    if bad and not force:
        raise RefusedError(
            f"not flashed, what is in force stays ({'; '.join(f'{g.name}: {g.text}' for g in bad)}): see {page}, "
            "collect more, or give --force"
        )
    return not bad


def of_stage(stage: str, gates: Sequence[Gate]) -> list[Gate]:
    """The gates that a stage states, marked as its own where no other's: a later fit of that stage replaces them."""
    return [gate._replace(stage=gate.stage or stage) for gate in gates]


def verdict(gates: Sequence[Gate]) -> str:
    """PASSED, or the names of the gates that failed, as a manifest has it."""
    bad = failed(gates)
    return FAILED + ", ".join(gate.name for gate in bad) if bad else PASSED


def gates_of_fit_file(path: Path) -> list[Gate] | None:
    """What a file of `cal fit --only material` or `relaxation` says of its gates; None where it says nothing."""
    try:
        return [Gate(**row) for row in json.loads(readable(path).read_text())["gates"]]
    except (OSError, ValueError, KeyError, TypeError):
        return None


def gates_in(file: CalibrationFile) -> list[Gate] | None:
    """What a file's manifest says of its gates; None where it says nothing."""
    try:
        tree: Any = json.loads(file.metadata.get("residuals", "{}"))
        rows = tree.get("gates") if isinstance(tree, dict) else None
        return None if rows is None else [Gate(**row) for row in rows]
    except (ValueError, TypeError):
        return None


def check_gates(file: CalibrationFile, *, force: bool) -> str:
    """What is to be said of a file whose report does not refuse it, or nothing.

    Raises
    ------
    RefusedError
        Its own report fails its gates, and `force` is not given.
    """
    gates = gates_in(file)
    said = file.metadata.get("gates", "")
    if gates is None and said.startswith(FAILED) and not force:
        raise RefusedError(f"this calibration {said}: collect more and fit again, or give --force")
    if not gates:
        return "this file has no report (`ruffini cal fit` writes one): nobody has judged how well it measures"
    bad = "; ".join(f"{gate.name}: {gate.text}" for gate in failed(gates))
    if bad and not force:
        raise RefusedError(f"this calibration fails its gates ({bad}): collect more and fit again, or give --force")
    return f"FAILS ITS GATES and is flashed by --force: {bad}" if bad else ""
