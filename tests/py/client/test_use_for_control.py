"""The rule of docs/how-to/use-forces-for-control.md: Python as printed, C++ in the example, tables as firmware."""

from __future__ import annotations

import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from made_frames import SCHEMA, frame

from ruffini.wire import Schema

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "docs" / "how-to" / "use-forces-for-control.md").read_text()
ENUMS = Schema.own().new("Status").DESCRIPTOR.file.enum_types_by_name


def block(language: str) -> str:
    (found,) = re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.M | re.S)
    return str(found)


def is_usable(
    axes: tuple[int, ...] = (0, 1, 2),
    *,
    is_line_unfit: bool = False,
    health: int = 0,
    age_s: float = 0.01,
    error_s: float = 0.001,
    n_covariance: int = 21,
    variance_un2: int = 100,
    **made: Any,
) -> bool:
    """What the page's Python says of a press of -3 mN, changed so."""
    names: dict[str, Any] = {}
    exec(block("python"), names)
    one = frame(**made)
    wrench = SCHEMA.new("Wrench")
    wrench.CopyFrom(one.messages["WRENCH"])
    wrench.covariance[:] = [variance_un2] * n_covariance
    one = replace(
        one,
        messages={"WRENCH": wrench},
        host_time_ns=time.monotonic_ns() - int(age_s * 1e9),
        host_time_error_ns=int(error_s * 1e9),
    )
    return bool(names["is_usable"](one, axes, is_line_unfit, health))


def bit(enum: str, name: str) -> int:
    return int(ENUMS[enum].values_by_name[name].number)


def test_a_young_valid_frame_is_usable() -> None:
    assert is_usable()


@pytest.mark.parametrize("flag", [v.name for v in ENUMS["FlagBit"].values if v.number])
def test_a_flag_forbids_it_unless_it_is_of_other_axes(flag: str) -> None:
    assert is_usable(flags=bit("FlagBit", flag)) == flag.startswith("FLAG_UNCALIBRATED_")


def test_only_the_axes_in_use_must_be_valid() -> None:
    planar = {"flags": 4, "validity": (1, 1, 2, 2, 2, 1)}
    assert is_usable((0, 1), **planar)
    assert not is_usable((1, 2), **planar)


def test_what_else_forbids_it() -> None:
    assert not is_usable(is_line_unfit=True)
    assert not is_usable(age_s=0.2)
    assert not is_usable(error_s=0.2)
    assert not is_usable(n_covariance=0)
    assert not is_usable(variance_un2=60_000**2)
    assert not is_usable(flags=1 << 19)
    assert not is_usable(health=1 << 17)


@pytest.mark.parametrize("name", [v.name for v in ENUMS["HealthBit"].values if v.number])
def test_a_health_bit_forbids_it_unless_the_page_lists_it(name: str) -> None:
    listed = re.findall(r"HEALTH_\w+", " ".join(re.findall(r"^\| (HEALTH_.*?) \|", PAGE, re.M)))
    assert len(listed) > 3
    assert is_usable(health=bit("HealthBit", name)) == (name in listed)


def test_the_page_lists_every_flag_that_leaves_forces_other_than_invalid() -> None:
    slots = (ROOT / "firmware" / "core" / "slots.h").read_text()
    wrong = re.search(r"kWrongFlags = (.*?);", slots, re.S)
    assert wrong is not None
    invalid = {re.sub(r"(?<!^)([A-Z])", r"_\1", name).upper() for name in re.findall(r"kFlag(\w+)", wrong[1])}
    flags = {v.name.removeprefix("FLAG_") for v in ENUMS["FlagBit"].values if v.number}
    rows = re.findall(r"^\| (FLAG_.*?) \|", PAGE, re.M)
    assert invalid < flags
    assert set(re.findall(r"FLAG_(\w+)", " ".join(rows))) == flags - invalid - {"STALE"}


def test_the_example_in_cpp_names_the_bits_of_the_page() -> None:
    example = (ROOT / "host" / "cpp" / "example" / "newtons.cpp").read_text()
    rule = re.search(r"^bool is_usable\(.*?^}$", example, re.M | re.S)
    assert rule is not None
    listed = re.findall(r"HEALTH_(\w+)", " ".join(re.findall(r"^\| (HEALTH_.*?) \|", PAGE, re.M)))
    assert re.findall(r"kHealth(\w+)", rule[0]) == [name.title().replace("_", "") for name in listed]
    assert re.findall(r"kFlag(\w+)", rule[0]) == ["UncalibratedXy", "UncalibratedZ"]
