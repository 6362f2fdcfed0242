"""A scale over USB HID: its reports, where it is found, what it says when it does not weigh. Pipes stand for it."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from ruffini.errors import InputError, NoDeviceError, RefusedError
from ruffini.rig.hid_scale import HidScale, find_scales, parse_report
from ruffini.rig.settings import scale_rig

G_N = 9.80665e-3


@pytest.mark.parametrize(
    ("report", "force_n", "is_over"),
    [
        ("030402006400", 100 * G_N, False),  # stable, grams, 100
        ("030302ff2d01", 30.1 * G_N, False),  # moving, tenths of a gram
        ("03020200 0000", 0.0, False),
        ("030502000500", -5 * G_N, False),
        ("030602000000", 0.0, True),
        ("030403fd fa00", 250 * G_N, False),  # 0.250 kg
        ("03040bff 2300", 3.5 * 0.2780139, False),  # 3.5 oz
        ("03040c00 0100", 4.4482216, False),
        ("03040100 e803", G_N, False),  # 1000 mg
        ("030402006400ffff", 100 * G_N, False),  # longer than it has to be
    ],
)
def test_a_report_is_a_force(report: str, force_n: float, is_over: bool) -> None:
    weighed = parse_report(bytes.fromhex(report))
    assert weighed is not None
    assert weighed == (pytest.approx(force_n, rel=1e-6), is_over)


@pytest.mark.parametrize(
    "report", ["", "03", "0304020064", "040402006400", "030902006400", "030002006400", "0304027f6400"]
)
def test_what_tells_no_weight_is_passed_over(report: str) -> None:
    assert parse_report(bytes.fromhex(report)) is None


def test_no_report_of_any_bytes_breaks_it() -> None:
    rng = np.random.default_rng(1)
    for _ in range(5000):
        report = bytes([3, *rng.integers(0, 256, rng.integers(0, 9)).astype(np.uint8)])
        with contextlib.suppress(InputError, RefusedError):
            weighed = parse_report(report)
            assert weighed is None or np.isfinite(weighed[0])


@pytest.mark.parametrize(("status", "sentence"), [(1, "reports a fault"), (7, "calibrated"), (8, "set to zero")])
def test_a_scale_that_does_not_weigh_says_why(status: int, sentence: str) -> None:
    with pytest.raises(RefusedError, match=sentence):
        parse_report(bytes([3, status, 2, 0, 0, 0]))


def test_a_unit_of_goldsmiths_is_refused() -> None:
    with pytest.raises(InputError, match="unit 10 of the HID tables: set it to grams"):
        parse_report(bytes([3, 4, 10, 0, 1, 0]))


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """Path of a scale, and where its reports are written."""
    path = tmp_path / "hidraw7"
    os.mkfifo(path)
    keep = os.open(path, os.O_RDWR | os.O_NONBLOCK)
    yield str(path), keep
    os.close(keep)


def test_it_presses_along_minus_z(pipe: tuple[str, int]) -> None:
    path, writer = pipe
    scale = HidScale(path, 0.01)
    os.write(writer, bytes.fromhex("040000000000") + bytes.fromhex("030402006400"))
    (reading,) = scale.read(1.0)
    assert reading.wrench[2] == pytest.approx(-100 * G_N)
    assert np.isnan(reading.wrench[[0, 1, 3, 4, 5]]).all()
    assert not reading.is_saturated
    with pytest.raises(NoDeviceError, match=r"no weight for 0.05 s: is the scale switched on\?"):
        scale.read(0.05)
    scale.close()


def test_a_scale_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(NoDeviceError, match=r"cannot be opened .*: is the scale plugged in, and on\?"):
        HidScale(str(tmp_path / "hidraw9"), 0.01)


def test_weighing_devices_are_found_by_their_descriptor(tmp_path: Path) -> None:
    for name, descriptor in (
        ("hidraw0", b"\x05\x01\x09\x06"),
        ("hidraw1", b"\x05\x8d\x09\x20\xa1\x01"),
        ("hidraw2", b""),
    ):
        (tmp_path / name / "device").mkdir(parents=True)
        (tmp_path / name / "device" / "report_descriptor").write_bytes(descriptor)
    (tmp_path / "hidraw3").mkdir()
    assert find_scales(tmp_path) == ["/dev/hidraw1"]
    assert find_scales(tmp_path / "none") == []


def test_a_bench_of_a_scale_needs_no_file() -> None:
    assert scale_rig().reference.kind == "weight"
    assert scale_rig("/dev/hidraw3").reference.kind == "hid"
    assert scale_rig("/dev/ttyUSB0").reference.kind == "text"
