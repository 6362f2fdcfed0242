"""Sections of twin.toml that say what stands behind a surface that is no plain slab."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from ruffini.boards import Section
from ruffini.sim.prony import Prony

LengthUm = Annotated[int, Field(ge=1, le=500_000)]
Modulus = Annotated[int, Field(ge=1000, le=100_000_000_000)]


class Relaxing(Section):
    """A rubber that relaxes: parts of its instantaneous stiffness, and the times in which they go."""

    relax_1e3: Annotated[list[Annotated[int, Field(ge=0, le=900)]], Field(max_length=8)] = Field(default=[])
    relax_ms: Annotated[list[Annotated[int, Field(ge=1, le=10_000_000)]], Field(max_length=8)] = Field(default=[])

    @model_validator(mode="after")
    def _pairs(self) -> Relaxing:
        if len(self.relax_1e3) != len(self.relax_ms):
            raise ValueError(f"relax_1e3 has {len(self.relax_1e3)} parts and relax_ms {len(self.relax_ms)} times")
        if sum(self.relax_1e3) > 900:
            raise ValueError("relax_1e3: at most 900 of 1000 may relax")
        return self

    def relaxation(self) -> Prony:
        """As a Prony series."""
        return Prony(tuple((w * 1e-3, t * 1e-3) for w, t in zip(self.relax_1e3, self.relax_ms, strict=True)))


class PlatformSettings(Relaxing):
    """[platform]: springs in a rubber sleeve that carry the pad's tray (`bodies.platform`)."""

    n_springs: Annotated[int, Field(ge=3, le=24)]
    ring_um: LengthUm  # radius on which the springs stand
    top_um: Annotated[int, Field(ge=-500_000, le=0)]  # z of their upper ends
    length_um: LengthUm
    coil_um: LengthUm  # mean diameter
    wire_um: LengthUm
    coils_1e3: Annotated[int, Field(ge=1000, le=100_000)]  # that give way
    sleeve_inner_um: LengthUm  # radii
    sleeve_outer_um: LengthUm
    sleeve_modulus_pa: Modulus

    @model_validator(mode="after")
    def _wire_fits(self) -> PlatformSettings:
        if self.wire_um >= self.coil_um:
            raise ValueError("wire_um must be below coil_um")
        if self.sleeve_inner_um >= self.sleeve_outer_um:
            raise ValueError("sleeve_inner_um must be below sleeve_outer_um")
        return self


class DomeSettings(Relaxing):
    """[dome]: the shell of a rubber dome (`bodies.dome`); board.toml has its wall and moduli."""

    cells: Annotated[int, Field(ge=8, le=48)] = 18  # elements along each way over the top


class SkinSettings(Relaxing):
    """[skin]: panels on rubber pyramids round a tube (`bodies.skin`); board.toml has the rubber's modulus.

    The pyramids stand under the openings of the lattice as this unit has it, as wide as those.
    """

    n_panels: Annotated[int, Field(ge=2, le=16)]
    seam_um: LengthUm  # between two panels
    panel_um: LengthUm  # thickness
    panel_modulus_pa: Modulus
    panel_poisson_1e4: Annotated[int, Field(ge=0, le=4999)]
    pyramid_um: LengthUm  # height
    squeezed_um: Annotated[int, Field(ge=0, le=5000)]  # of it, at rest
    mask_gap_um: LengthUm  # way of the panel until the black mask meets the tube
    mask_um: LengthUm  # thickness
    cover_um: LengthUm  # of the black layer outside
    cells_x: Annotated[int, Field(ge=4, le=40)] = 12  # elements of a panel round the tube
    cells_y: Annotated[int, Field(ge=4, le=60)] = 24
