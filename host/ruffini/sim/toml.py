"""Settings back to TOML, for recordings that carry what they were made with."""

from __future__ import annotations

import json
from typing import Any

from pydantic import BaseModel


def inline(value: Any) -> str:
    """A value on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {inline(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(inline(v) for v in value) + "]"
    return json.dumps(value)


def settings_toml(name: str, settings: BaseModel) -> str:
    """Table `name` of settings: plain keys first, then one sub-table for each section. None is left out."""
    tree = settings.model_dump(by_alias=True, exclude_none=True)
    text = f"\n[{name}]\n" + "".join(f"{k} = {inline(v)}\n" for k, v in tree.items() if not isinstance(v, dict))
    for section, values in tree.items():
        if isinstance(values, dict):
            text += f"\n[{name}.{section}]\n" + "".join(f"{k} = {inline(v)}\n" for k, v in values.items())
    return text
