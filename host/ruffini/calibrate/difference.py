"""What differs between two calibration files, table by table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ruffini.calibrate.container import CalibrationFile

UNINTERESTING = {
    "key_id",
    "tool_version",
    "inputs_sha256",
    "residuals",
}  # differ in nearly every two files, and are long


@dataclass(frozen=True)
class Difference:
    """A table or a word of the manifest that is not the same."""

    name: str
    state: str  # added, removed, changed
    before: str
    after: str

    def __str__(self) -> str:
        change = {"added": self.after, "removed": self.before}.get(self.state, f"{self.before} -> {self.after}")
        return f"{self.name}: {self.state}, {change}"


def differences(before: CalibrationFile | None, after: CalibrationFile) -> list[Difference]:
    """Words of the manifest, then tables; where all is the same, nothing.

    A changed table says how many of its numbers changed, and by how much at most, in its own steps.
    """
    old_words = before.metadata if before else {}
    old_tables = before.tensors if before else {}
    out = []
    for key in sorted(old_words.keys() | after.metadata.keys()):
        old, new = old_words.get(key), after.metadata.get(key)
        if old != new and key not in UNINTERESTING:
            out.append(Difference(key, _state(old, new), old or "", new or ""))
    for name in sorted(old_tables.keys() | after.tensors.keys()):
        one, other = old_tables.get(name), after.tensors.get(name)
        said = [f"{t.dtype} {'x'.join(map(str, t.shape)) or '1'}" if t is not None else "" for t in (one, other)]
        if one is None or other is None or one.dtype != other.dtype or one.shape != other.shape:
            out.append(Difference(name, _state(one, other), *said))
            continue
        step = abs(other.astype(np.int64) - one.astype(np.int64))
        if step.any():
            changed = f"{int((step > 0).sum())} of {step.size} numbers, by at most {int(step.max())}"
            out.append(Difference(name, "changed", said[0], changed))
    return out


def _state(before: object, after: object) -> str:
    return "added" if before is None else "removed" if after is None else "changed"
