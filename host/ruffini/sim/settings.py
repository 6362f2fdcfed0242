"""twin.toml: how a simulated unit differs from its board, and its optics. Strict."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationError, model_validator

from ruffini.boards import Board, Section, board_names, boards_folder
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.older_python import tomllib
from ruffini.sim.bodies import settings as bodies
from ruffini.sim.optics import settings as optics
from ruffini.sim.prony import Prony

Strain = Literal["linear", "finite"]
TWIN = "twin.toml"
Pair = Annotated[list[Annotated[int, Field(ge=-5000, le=5000)]], Field(min_length=2, max_length=2)]


class UnitSettings(Section):
    """[unit]: what the manufacturer did not hit exactly."""

    lattice_shift_um: Pair  # of the printed lattice against [markers]
    lattice_turn_mrad: Annotated[int, Field(ge=-200, le=200)]
    friction_1e3: Annotated[int, Field(ge=0, le=2000)]
    seed: Annotated[int, Field(ge=0, le=1_000_000)] = 1  # of this unit's flakes, dust and lamp phases


class MeshSettings(Section):
    """[mesh]: quadratic elements of a flat pad along x and y; surface nodes are half an element apart."""

    cells_x: Annotated[int, Field(ge=2, le=64)] = 24
    cells_y: Annotated[int, Field(ge=2, le=64)] = 19


class PadSettings(bodies.Relaxing):
    """[pad]: what a flat pad's mechanics count; board.toml has its size and moduli (E: the stiffness after 1 s).

    strain = "finite" is a neo-Hookean solid (`ruffini.sim.finite`), a hundred times slower than "linear".
    The gel relaxes (relax_1e3, relax_ms) where is_relaxing says so.
    """

    strain: Strain = "linear"
    is_relaxing: bool = False

    def prony(self) -> Prony:
        """The relaxation that counts."""
        return self.relaxation() if self.is_relaxing else Prony()


class TwinSettings(Section):
    """A whole twin.toml."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    unit: UnitSettings
    light: optics.Light
    noise: optics.NoiseSettings
    mesh: MeshSettings = MeshSettings()
    pad: PadSettings = PadSettings()
    shape: optics.ShapeSettings = optics.ShapeSettings()
    lens: optics.LensSettings | None = None
    gel: optics.GelSettings | None = None
    view: list[optics.ViewSettings] = Field(default=[])
    dots: optics.DotSettings | None = None
    glitter: optics.GlitterSettings | None = None
    pins: optics.PinSettings | None = None
    targets: optics.TargetSettings | None = None
    sensor: optics.SensorSettings | None = None
    wear: optics.WearSettings | None = None
    warming: list[optics.WarmingSettings] | None = None
    platform: bodies.PlatformSettings | None = None
    dome: bodies.DomeSettings | None = None
    skin: bodies.SkinSettings | None = None

    def with_pad(self, *, strain: Strain | None = None, is_relaxing: bool | None = None) -> TwinSettings:
        """The same with another strain or relaxation of the pad; None leaves what there is.

        Raises
        ------
        InputError
            A gel is to relax and [pad] does not say how.
        """
        asked = {"strain": strain, "is_relaxing": is_relaxing}
        pad = self.pad.model_copy(update={key: value for key, value in asked.items() if value is not None})
        if pad.is_relaxing and not pad.relax_1e3:
            raise InputError("this board's twin.toml does not say how its gel relaxes: give [pad] relax_1e3, relax_ms")
        return self.model_copy(update={"pad": pad})

    @model_validator(mode="after")
    def _cross_check(self) -> TwinSettings:
        if self.gel is not None and (self.shape.kind != "plane" or self.pins is not None):
            raise ValueError("[gel] refracts at the flat back of a plane pad without [pins]")
        if self.pad.is_relaxing and not self.pad.relax_1e3:
            raise ValueError("[pad] is_relaxing needs relax_1e3 and relax_ms")
        if self.platform is not None and self.shape.kind != "plane":
            raise ValueError("[platform] carries a plane pad")
        if self.dome is not None and self.shape.kind != "dome":
            raise ValueError('[dome] belongs to [shape] kind = "dome"')
        window_um = self.light.window_um if self.light.kind == "electroluminescent" else 0
        if window_um and not (self.shape.kind == "tube" and window_um < self.shape.radius_um):
            raise ValueError('[light] window_um is the wall of [shape] kind = "tube", and thinner than its radius')
        self._check_warming()
        if self.skin is not None and self.shape.kind != "tube":
            raise ValueError('[skin] belongs to [shape] kind = "tube"')
        return self

    def _check_warming(self) -> None:
        n_lamps = optics.n_lamps(self.light)
        for part in self.warming or []:
            if part.lamp >= n_lamps:
                raise ValueError(f"[[warming]] lamp must be below {n_lamps}, the number of lamps of [light]")
            if sum(one.share_1e3 for one in self.warming or [] if one.lamp == part.lamp) > 1000:
                raise ValueError(f"[[warming]] share_1e3 of lamp {part.lamp} is more than 1000 together")
            if part.place_um is not None and self.light.kind == "electroluminescent":
                raise ValueError("[[warming]] place_um: an electroluminescent sheet is everywhere")


def twin_names() -> list[str]:
    """Names of the boards that come with ruffini and can be simulated."""
    return [name for name in board_names() if (boards_folder() / name / TWIN).is_file()]


def load_twin(board: Board) -> TwinSettings:
    """twin.toml beside the board's board.toml.

    Raises
    ------
    InputError
        The board has no twin, or the file is not as it should be.
    """
    path = (board.folder or Path()) / TWIN
    if not path.is_file():
        raise InputError(
            f"board {board.name!r} has no optics to simulate: {path} does not exist; show a recording with "
            f"`ruffini live --camera VIDEO --board {board.name}`, simulate another board "
            f"({', '.join(twin_names())}), or write that file"
        )
    try:
        return parse_twin(readable(path).read_text("utf-8"), str(path), board)
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from error


def parse_twin(text: str, where: str, board: Board) -> TwinSettings:
    """A twin.toml's text as checked settings; `where` names it in messages.

    Raises
    ------
    InputError
        It is not as it should be, or does not fit the board.
    """
    try:
        twin = TwinSettings.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{where}: not TOML: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        # The kind of light stands in pydantic's path, but not in the file.
        key = ".".join(str(part) for part in first["loc"] if part not in optics.LIGHT_KINDS)
        kind = {"extra_forbidden": "unknown key, check the spelling or remove it",
                "missing": "key is missing"}.get(first["type"], first["msg"])  # fmt: skip
        raise InputError(f"{where}: {key}: {kind}") from error
    has_lattice = board.markers is not None and board.markers.polarity != "texture"
    if not has_lattice and (twin.dots is not None or isinstance(twin.light, optics.Electroluminescent)):
        raise InputError(f"{where}: dots and openings lie on the lattice of [markers], which board.toml does not have")
    if board.camera.width_px % max(len(twin.view), 1):
        raise InputError(f"{where}: {len(twin.view)} views do not share {board.camera.width_px} columns evenly")
    return twin
