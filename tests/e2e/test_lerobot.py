"""The LeRobot camera plugin on the real daemon; on a FAKE of LeRobot's base classes where lerobot is not installed."""

from __future__ import annotations

import abc
import contextlib
import importlib
import importlib.util
import itertools
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from hang import HANG_S
from tiny_sensor import ROOT, Sensor, start

from ruffini.device import Connection

HANG_MS = 1e3 * HANG_S
METHODS = ("is_connected", "find_cameras", "connect", "read", "async_read", "disconnect")  # abstract in lerobot 0.6.1


class FakeConfig:
    """draccus' registry of choices, as far as cameras use it."""

    choices: ClassVar[dict[str, type]] = {}

    @classmethod
    def register_subclass(cls, name: str) -> Any:
        return lambda kind: cls.choices.setdefault(name, kind)


def fake_camera() -> type:
    """A base class that cannot be made unless all its methods are there."""

    def init(self: Any, config: Any) -> None:
        self.fps, self.width, self.height = config.fps, config.width, config.height

    return abc.ABCMeta("Camera", (), {"__init__": init, **{m: abc.abstractmethod(lambda self: None) for m in METHODS}})


def fake_lerobot() -> dict[str, types.ModuleType]:
    modules = {
        name: types.ModuleType(name)
        for name in ("lerobot", "lerobot.cameras", "lerobot.cameras.camera", "lerobot.cameras.configs", "lerobot.utils",
                     "lerobot.utils.errors")
    }  # fmt: skip
    modules["lerobot.cameras.camera"].Camera = fake_camera()  # type: ignore[attr-defined]
    modules["lerobot.cameras.configs"].CameraConfig = FakeConfig  # type: ignore[attr-defined]
    for name in ("DeviceAlreadyConnectedError", "DeviceNotConnectedError"):
        setattr(modules["lerobot.utils.errors"], name, type(name, (ConnectionError,), {}))
    return modules


@pytest.fixture(scope="module")
def plugin() -> Iterator[Any]:
    """The plugin's package."""
    is_real = importlib.util.find_spec("lerobot") is not None
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "host" / "lerobot_plugin"))
        for name, module in {} if is_real else fake_lerobot().items():  # type: ignore[attr-defined]
            patch.setitem(sys.modules, name, module)
        yield importlib.import_module("lerobot_camera_ruffini")
        for name in [n for n in sys.modules if n.startswith("lerobot_camera_ruffini")]:
            del sys.modules[name]


@contextlib.contextmanager
def camera(plugin: Any, port: str, **settings: Any) -> Iterator[Any]:
    made = plugin.RuffiniCamera(plugin.RuffiniCameraConfig(port=port, **settings))
    try:
        yield made
    finally:
        if made.is_connected:
            made.disconnect()


@pytest.fixture
def port(sensor: Sensor, tmp_path: Path) -> Iterator[str]:
    """A calibrated sensor that is pressed again and again."""
    with start(sensor, tmp_path, "--loop") as daemon:
        with Connection(daemon.port) as host:
            host.flash(sensor.calibration)
        yield daemon.port


def test_pictures_are_the_field_that_comes_with_them(plugin: Any, port: str) -> None:
    with camera(plugin, port, width=90, height=70, force_max_n=0.2) as cam:
        cam.connect()
        began_s, pressed = time.perf_counter(), 0
        for _ in range(60):
            picture, touch = cam.async_read(HANG_MS), cam.touch
            assert (picture.shape, picture.dtype) == ((70, 90, 3), np.uint8)
            assert touch.points.shape[1] == 6
            assert touch.is_simulated
            np.testing.assert_allclose(touch.points[:, 3:].sum(axis=0), touch.wrench[:3], atol=1e-9)
            np.testing.assert_allclose((touch.points[:, 1] * touch.points[:, 5]).sum(), touch.wrench[3], atol=1e-7)
            hardest = int(touch.points[:, 5].argmin())
            n_x = len(np.unique(touch.points[:, 0]))
            row, column = hardest // n_x, hardest % n_x
            n_y = len(touch.points) // n_x
            shown = picture[(2 * row + 1) * 70 // (2 * n_y), (2 * column + 1) * 90 // (2 * n_x)]
            want = 128 + 127 * np.clip(touch.points[hardest, 3:] / 0.2, -1, 1)
            np.testing.assert_allclose(shown, want, atol=0.51)
            pressed += touch.wrench[2] < -0.1
        assert pressed > 5
        assert began_s < touch.captured_s < time.perf_counter()


def test_each_picture_is_given_out_once_and_the_latest_again(plugin: Any, port: str) -> None:
    with camera(plugin, port) as cam:
        cam.connect()
        numbers = []
        for _ in range(10):
            cam.async_read(HANG_MS)
            numbers.append(cam.touch.number)
        assert all(b > a for a, b in itertools.pairwise(numbers))
        assert cam.read_latest().shape == cam.read_latest().shape == (240, 320, 3)
        before = cam.touch.number
        assert cam.read().shape == (240, 320, 3)
        assert cam.touch.number > before


def test_a_heatmap_is_grey_and_shows_the_pressure(plugin: Any) -> None:
    force = np.zeros((2, 3, 3))
    force[1, 2] = [0.3, 0, -0.1]
    module = importlib.import_module("lerobot_camera_ruffini.ruffini_camera")
    picture = module.render(force, "heatmap", 0.2, 6, 4)
    assert picture.shape == (4, 6, 3)
    assert (picture[2:, 4:] == 128).all()
    picture[2:, 4:] = 0
    assert not picture.any()


def test_a_force_that_is_not_valid_is_no_picture(plugin: Any, sensor: Sensor, tmp_path: Path) -> None:
    with start(sensor, tmp_path, "--loop") as daemon, camera(plugin, daemon.port) as cam:
        cam.connect(warmup=False)
        with pytest.raises(TimeoutError, match="no valid frame within 300 ms"):
            cam.async_read(300)
        with pytest.raises(RuntimeError, match="no valid frame yet"):
            cam.read_latest()
        with pytest.raises(RuntimeError, match="read a picture first"):
            _ = cam.touch


def test_connecting_and_what_is_wrong_with_it(plugin: Any, port: str, tmp_path: Path) -> None:
    with camera(plugin, port) as cam:
        with pytest.raises(ConnectionError, match="is not connected"):
            cam.async_read()
        with pytest.raises(ConnectionError, match="is not connected"):
            cam.disconnect()
        cam.connect()
        assert cam.is_connected
        with pytest.raises(ConnectionError, match="already connected"):
            cam.connect()
        cam.disconnect()
        assert not cam.is_connected
        cam.connect()
    with camera(plugin, str(tmp_path / "nowhere")) as cam, pytest.raises(ConnectionError, match="nowhere"):
        cam.connect()
    for wrong in ({"render": "jet"}, {"force_max_n": 0.0}, {"width": None}):
        with pytest.raises(ValueError, match=r"render|force_max_n|width"):
            plugin.RuffiniCameraConfig(**wrong)


def test_lerobot_makes_it_by_its_type(plugin: Any, port: str) -> None:
    """By LeRobot's own rules: the class is the configuration's name without Config, in the package above it."""
    config_class = importlib.import_module("lerobot_camera_ruffini.config_ruffini").RuffiniCameraConfig
    package = config_class.__module__.rpartition(".")[0]
    assert (
        getattr(importlib.import_module(package), config_class.__name__.removesuffix("Config")) is plugin.RuffiniCamera
    )
    if "lerobot.cameras.utils" in sys.modules:  # the real one
        made = sys.modules["lerobot.cameras.utils"].make_cameras_from_configs({"pad": config_class(port=port)})
        assert type(made["pad"]) is plugin.RuffiniCamera
        assert made["pad"].config.type == "ruffini"
    else:
        assert FakeConfig.choices == {"ruffini": config_class}
