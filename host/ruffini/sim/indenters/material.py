"""What indenters are made of."""

from __future__ import annotations

from dataclasses import dataclass

from ruffini.errors import InputError
from ruffini.rubber import RUBBER_POISSON, shore_a_modulus

CORE_STIFFNESS = 1000.0  # modulus of a "rigid" core over that of the shell round it


@dataclass(frozen=True)
class Material:
    """An elastic indenter, held by a rigid plate at its back.

    Attributes
    ----------
    modulus_pa : of the shell, or of all of it.
    core_part : radius of a rigid core round the axis, over the indenter's radius; 0 = no core.
    skin_part : thickness of the shell over the core's face, over the indenter's radius.
    """

    modulus_pa: float
    poisson: float = RUBBER_POISSON
    core_part: float = 0.0
    skin_part: float = 0.0

    def __post_init__(self) -> None:
        if not (self.modulus_pa > 0 and 0 <= self.poisson < 0.4999):
            raise InputError(
                f"an indenter of {self.modulus_pa:g} Pa and Poisson's ratio {self.poisson:g} cannot be: "
                "the modulus must be positive and the ratio 0 to 0.4999"
            )
        if not (0 <= self.core_part < 1 and 0 <= self.skin_part < 1):
            raise InputError("core and skin are parts of the indenter's radius: each must be 0 to 1")

    @classmethod
    def of_shore_a(cls, shore_a: float, *, core_part: float = 0.0, skin_part: float = 0.0) -> Material:
        """Rubber of a hardness, with or without a rigid core."""
        return cls(shore_a_modulus(shore_a), core_part=core_part, skin_part=skin_part)
