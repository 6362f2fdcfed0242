"""Sections of twin.toml that say what the camera sees. Every section but light and noise may be absent."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from ruffini.boards import Section

PerMille = Annotated[int, Field(ge=0, le=1000)]
OffsetUm = Annotated[int, Field(ge=-500_000, le=500_000)]
LengthUm = Annotated[int, Field(ge=1, le=500_000)]
Place = Annotated[list[OffsetUm], Field(min_length=3, max_length=3)]
Power = Annotated[int, Field(ge=1, le=10_000)]
Powers = Annotated[list[Power], Field(min_length=3, max_length=3)]
Coefficient = Annotated[int, Field(ge=-10_000_000, le=10_000_000)]
Turn = Annotated[list[Annotated[int, Field(ge=-3200, le=3200)]], Field(min_length=3, max_length=3)]
Level = Annotated[int, Field(ge=1, le=255)]


class ShapeSettings(Section):
    """[shape]: of the undeformed surface that the camera sees (`optics.charts`)."""

    kind: Literal["plane", "tube", "dome"] = "plane"
    radius_um: Annotated[int, Field(ge=0, le=500_000)] = 0

    @model_validator(mode="after")
    def _round_shapes_have_a_radius(self) -> ShapeSettings:
        if (self.kind == "plane") != (self.radius_um == 0):
            raise ValueError("radius_um belongs to a tube or a dome, and must be positive there")
        return self


class LensSettings(Section):
    """[lens]: distortion as OpenCV counts it, in units of 1e-6."""

    model: Literal["radtan", "fisheye"]  # k1 k2 p1 p2 k3, or k1 k2 k3 k4
    coefficients_1e6: Annotated[list[Coefficient], Field(min_length=4, max_length=5)]

    @model_validator(mode="after")
    def _count(self) -> LensSettings:
        if len(self.coefficients_1e6) != (5 if self.model == "radtan" else 4):
            raise ValueError("coefficients_1e6 must be k1 k2 p1 p2 k3 (radtan) or k1 k2 k3 k4 (fisheye)")
        return self


class GelSettings(Section):
    """[gel]: refraction at the flat back of a clear pad; the surface is seen through the whole pad."""

    index_1e3: Annotated[int, Field(ge=1000, le=2500)]


class MirrorSettings(Section):
    """A plane mirror between pinhole and pad."""

    point_um: Place
    normal_1e3: Annotated[list[Annotated[int, Field(ge=-1000, le=1000)]], Field(min_length=3, max_length=3)]


class ViewSettings(Section):
    """[[view]]: one part of the frame; views stand side by side, from left to right."""

    offset_um: Place = Field(default=[0, 0, 0])  # of the pinhole, from (0, 0, -standoff)
    turn_mrad: Turn = Field(default=[0, 0, 0])  # about x, then y, then z
    mirror: MirrorSettings | None = None


class _Light(Section):
    mean_level: Annotated[int, Field(ge=10, le=240)]  # grey level of the untouched surface
    ambient_1e3: Annotated[int, Field(ge=0, le=10_000)] = 0  # diffuse light, over the mean light of the sources
    vignette_1e3: PerMille = 0  # loss at the image's corner


class RgbLeds(_Light):
    """[light] kind = "rgb_leds": three near lamps, one a colour."""

    kind: Literal["rgb_leds"]
    led_b_um: Place
    led_g_um: Place
    led_r_um: Place
    power_1e3: Powers  # B, G, R
    crosstalk_1e3: Annotated[int, Field(ge=0, le=300)]  # share of each lamp in the camera's other two channels


class WhiteRing(_Light):
    """[light] kind = "white_ring": lamps evenly spaced on a ring about the camera's axis."""

    kind: Literal["white_ring"]
    n_leds: Annotated[int, Field(ge=3, le=64)]
    radius_um: LengthUm
    z_um: OffsetUm
    tint_1e3: Powers  # B, G, R
    # Compression of a translucent layer before a black one that makes it e times darker; 0: an opaque surface.
    darkening_um: Annotated[int, Field(ge=0, le=100_000)] = 0


class Electroluminescent(_Light):
    """[light] kind = "electroluminescent": a glowing sheet behind translucent pyramids in a black mask."""

    kind: Literal["electroluminescent"]
    aperture_um: LengthUm  # side of a square opening at every marker of board.toml
    attenuation_um: LengthUm  # compression of the layer that makes it e times brighter
    leak_1e3: PerMille  # through the black mask, of the light in an opening
    blur_um: LengthUm
    tint_1e3: Powers  # B, G, R
    window_um: Annotated[int, Field(ge=0, le=20_000)] = 0  # wall of the clear tube on which the mask lies; 0: none
    window_index_1e3: Annotated[int, Field(ge=1000, le=2500)] = 1490  # acrylic


Light = Annotated[RgbLeds | WhiteRing | Electroluminescent, Field(discriminator="kind")]
LIGHT_KINDS = ("rgb_leds", "white_ring", "electroluminescent")


def n_lamps(light: Light) -> int:
    """Number of lamps, or of glowing sheets, that a light consists of."""
    if isinstance(light, RgbLeds):
        return 3
    return light.n_leds if isinstance(light, WhiteRing) else 1


class DotSettings(Section):
    """[dots]: printed on the surface, at board.toml's lattice as the unit has it."""

    darkness_1e3: PerMille
    blur_um: Annotated[int, Field(ge=1, le=1000)]


class GlitterSettings(Section):
    """[glitter]: coloured flakes in the surface, each tilted its own way."""

    per_mm2_1e3: Annotated[int, Field(ge=1, le=100_000)]
    diameter_um: Annotated[int, Field(ge=10, le=5000)]
    tilt_mrad: Annotated[int, Field(ge=1, le=800)]  # standard deviation
    lobe_mrad: Annotated[int, Field(ge=10, le=1500)]  # width of a flake's reflection
    matte_1e3: PerMille  # share of its brightness that comes from everywhere
    strength_1e3: Annotated[int, Field(ge=1, le=5000)]  # brightness in its colour, over the surface's grey


class PinSettings(Section):
    """[pins]: they stand inwards on the surface, hexagonally, the n nearest to its middle."""

    n: Annotated[int, Field(ge=1, le=4096)]
    pitch_um: LengthUm
    length_um: Annotated[int, Field(ge=0, le=20_000)]
    radius_um: LengthUm
    level: Level


class TargetSettings(Section):
    """[targets]: discs on the tray that carries the pad, in the pad's frame; they move with the tray alone."""

    places_um: Annotated[list[Place], Field(min_length=1, max_length=64)]
    radius_um: LengthUm
    level: Level


class SensorSettings(Section):
    """[sensor]: what camera and transport do to the light."""

    bayer: Literal["none", "rggb"] = "none"
    jpeg_quality: Annotated[int, Field(ge=0, le=100)] = 0  # 0 = not compressed
    shutter_1e3: PerMille = 0  # part of the frame period in which it is open; 0 = no motion blur


class NoiseSettings(Section):
    """[noise]."""

    read_1e3: Annotated[int, Field(ge=0, le=20_000)]  # standard deviation, 1/1000 grey level
    shot_1e3: Annotated[int, Field(ge=0, le=1000)]  # variance per grey level, 1/1000


class WearSettings(Section):
    """[wear]: what age does to the optics."""

    led_drift_1e3: PerMille = 0  # amplitude of a slow change of every lamp
    led_drift_s: Annotated[int, Field(ge=1, le=100_000)] = 600  # its period
    dead_leds: list[Annotated[int, Field(ge=0, le=63)]] = Field(default=[])
    n_dust: Annotated[int, Field(ge=0, le=1000)] = 0
    dust_px: Annotated[int, Field(ge=1, le=100)] = 3
    dust_darkness_1e3: PerMille = 300


class WarmingSettings(Section):
    """[[warming]]: a part of a lamp that loses light while it warms up after time 0.

    A bar of LEDs is a lamp of several parts. Each shines from its own place, so its loss varies over the picture as
    its share of the light there does: share (1 - loss (1 - exp(-t / time))) of the lamp's first light.
    """

    lamp: Annotated[int, Field(ge=0, le=63)]  # in the order of [light]; of rgb_leds 0 B, 1 G, 2 R
    place_um: Place | None = None  # the lamp's own where left out
    share_1e3: PerMille = 1000  # of the lamp's light; the lamp's own place keeps what no part takes
    loss_1e3: PerMille
    time_s: Annotated[int, Field(ge=1, le=100_000)]
