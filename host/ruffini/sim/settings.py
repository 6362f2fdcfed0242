"""twin.toml: how a simulated unit differs from its board, and its optics. Strict."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError

from ruffini.boards import Board, Section
from ruffini.errors import InputError

PerMille = Annotated[int, Field(ge=0, le=1000)]
OffsetUm = Annotated[int, Field(ge=-500_000, le=500_000)]
Pair = Annotated[list[Annotated[int, Field(ge=-5000, le=5000)]], Field(min_length=2, max_length=2)]
Place = Annotated[list[OffsetUm], Field(min_length=3, max_length=3)]
Powers = Annotated[list[Annotated[int, Field(ge=1, le=10_000)]], Field(min_length=3, max_length=3)]


class UnitSettings(Section):
    """[unit]: what the manufacturer did not hit exactly."""

    lattice_shift_um: Pair
    lattice_turn_mrad: Annotated[int, Field(ge=-200, le=200)]
    friction_1e3: Annotated[int, Field(ge=0, le=2000)]


class LightSettings(Section):
    """[light]."""

    led_b_um: Place
    led_g_um: Place
    led_r_um: Place
    power_1e3: Powers
    ambient_1e3: PerMille
    crosstalk_1e3: Annotated[int, Field(ge=0, le=300)]
    mean_level: Annotated[int, Field(ge=10, le=240)]
    vignette_1e3: PerMille


class DotSettings(Section):
    """[dots]."""

    darkness_1e3: PerMille
    blur_um: Annotated[int, Field(ge=1, le=1000)]


class NoiseSettings(Section):
    """[noise]."""

    read_1e3: Annotated[int, Field(ge=0, le=20_000)]
    shot_1e3: Annotated[int, Field(ge=0, le=1000)]


class TwinSettings(Section):
    """A whole twin.toml."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    unit: UnitSettings
    light: LightSettings
    dots: DotSettings
    noise: NoiseSettings


def load_twin(board: Board) -> TwinSettings:
    """twin.toml beside the board's board.toml.

    Raises
    ------
    InputError
        The board has no twin, or the file is not as it should be.
    """
    path = (board.folder or Path()) / "twin.toml"
    if not path.is_file():
        raise InputError(f"board {board.name!r} has no optics to simulate: {path} does not exist")
    try:
        return TwinSettings.model_validate(tomllib.loads(path.read_bytes().decode("utf-8")))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        kind = {"extra_forbidden": "unknown key, check the spelling or remove it",
                "missing": "key is missing"}.get(first["type"], first["msg"])  # fmt: skip
        raise InputError(f"{path}: {key}: {kind}") from error
