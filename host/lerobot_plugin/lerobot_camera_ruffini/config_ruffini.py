"""What can be chosen on LeRobot's command line."""

from __future__ import annotations

from dataclasses import dataclass

from lerobot.cameras.configs import CameraConfig

RENDERS = ("vector_rgb", "heatmap")


@CameraConfig.register_subclass("ruffini")
@dataclass(kw_only=True)
class RuffiniCameraConfig(CameraConfig):
    """One pad.

    Parameters
    ----------
    port, serial : which sensor; empty: the only one there is.
    sensor : of a device with several.
    render : `vector_rgb`: force x, y, z of each node as red, green, blue, 128 is zero. `heatmap`: how hard each node is
        pressed in, as grey, 0 is nothing.
    force_max_n : force of one node at which a colour is full, newtons. A node carries millinewtons.
    width, height : of the picture, pixels; each node is a rectangle of it.
    """

    port: str = ""
    serial: str = ""
    sensor: int = 0
    render: str = "vector_rgb"
    force_max_n: float = 0.05
    width: int | None = 320
    height: int | None = 240
    fps: int | None = 60

    def __post_init__(self) -> None:
        if self.render not in RENDERS:
            raise ValueError(f"render is {self.render!r}: choose one of {', '.join(RENDERS)}")
        if not self.force_max_n > 0:
            raise ValueError(f"force_max_n is {self.force_max_n}: it must be above 0")
        if not self.width or not self.height:
            raise ValueError("width and height are needed: LeRobot lays its data set out by them")
