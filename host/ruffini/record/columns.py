"""Results as flat columns of one number or string each, with units in their names; invalid numbers are NaN."""

from __future__ import annotations

import json
from dataclasses import fields
from typing import Any, get_args, get_type_hints

from ruffini.device.results import (
    VALID,
    Contact,
    ContactModel,
    FlowParts,
    Learned,
    SkinTouch,
    Softness,
    ToolTouch,
    valid_or_nan,
)

Row = dict[str, Any]
NAN = float("nan")
PARTS: dict[str, Any] = {"skin": SkinTouch, "tool": ToolTouch, "model": ContactModel, "flow_parts": FlowParts}
UNITS = {"curl_free": "curl_free_m", "divergence_free": "divergence_free_m", "twist": "twist_rad"}


def contact_columns(contact: Contact | None, *, has_absent: bool = True) -> Row:
    """Columns of a contact, including the parts that stages add to it; all NaN for None.

    With `has_absent` also the columns of parts that this contact lacks, so that all contacts have the same columns.
    """
    c = contact
    is_known = c is not None and c.validity == VALID
    center = c.center if is_known and c is not None else (NAN, NAN)
    force = (NAN,) * 3 if c is None else c.force
    row = {
        "contact_id": -1 if c is None else c.id, "contact_validity": 0 if c is None else c.validity,
        "contact_area_m2": c.area if is_known and c is not None else NAN,
        **{f"contact_center_{axis}_m": v for axis, v in zip("xy", center, strict=True)},
        **{f"contact_force_{axis}_n": v for axis, v in zip("xyz", force, strict=True)},
        "contact_peak_depth_m": NAN if c is None else float(valid_or_nan([c.peak_depth], (c.validity,), c.flags)[0]),
        "contact_reaches_border": c is not None and c.reaches_border,
        "contact_slip_state": "" if c is None or c.slip_state is None else c.slip_state,
    }  # fmt: skip
    for name in ("shear_ratio", "slip_share", "friction", "friction_sigma", "slip_margin_n"):
        row[f"contact_{name}"] = _number(None if c is None else getattr(c, name))
    for name, kind in PARTS.items():
        part = None if c is None else getattr(c, name)
        if has_absent or part is not None:
            row |= _columns(kind, part, f"contact_{name}_")
    return row


def softness_columns(softness: Softness | None) -> Row:
    """Columns of the last squeeze; NaN where the board measures none."""
    return _columns(Softness, softness, "softness_")


def learned_columns(learned: Learned | None) -> Row:
    """Columns of the newest output of a learned network; its quantities are JSON under the network's own names."""
    m = learned
    return {
        "learned": "" if m is None else json.dumps(m.quantities), "learned_frame": -1 if m is None else m.frame,
        "learned_is_valid": m is not None and m.is_valid, "learned_took_s": NAN if m is None else m.took_s,
        "learned_latency_s": NAN if m is None else m.latency_s, "learned_rate_hz": NAN if m is None else m.rate_hz,
    }  # fmt: skip


def _number(value: float | None) -> float:
    return NAN if value is None else value


def _columns(kind: Any, part: Any, prefix: str) -> Row:
    out: Row = {}
    hints = get_type_hints(kind)
    for field in fields(kind):
        name, hint = UNITS.get(field.name, field.name), hints[field.name]
        value = None if part is None else getattr(part, field.name)
        if n := len(get_args(hint)) if getattr(hint, "__origin__", None) is tuple else 0:
            stem, _, unit = name.rpartition("_")
            numbers = (NAN,) * n if value is None else value
            out |= {f"{prefix}{stem}_{axis}_{unit}": v for axis, v in zip("xyz", numbers, strict=False)}
        elif str in (hint, *get_args(hint)):
            out[prefix + name] = value or ""
        elif hint is int:
            out[prefix + name] = 0 if value is None else value
        else:
            out[prefix + name] = _number(value)
    return out
