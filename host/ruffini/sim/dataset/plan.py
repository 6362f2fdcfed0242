"""What a dataset is: everything that its samples follow from."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from ruffini.boards import Board, Section, parse_board
from ruffini.errors import InputError
from ruffini.files import readable
from ruffini.sim.settings import TwinSettings, parse_twin
from ruffini.sim.unit import PadError

PLAN_FILE = "plan.json"
Factor = Annotated[float, Field(gt=0, le=10)]


class Plan(Section):
    """A dataset's whole recipe. Sample i follows from the plan and i alone."""

    board_toml: str
    twin_toml: str
    n: Annotated[int, Field(ge=1, le=100_000_000)]
    shard_size: Annotated[int, Field(ge=1, le=10_000)]
    seed: Annotated[int, Field(ge=0, le=2**31)]
    scale_modulus: Factor = 1.0
    scale_poisson: Factor = 1.0
    scale_thickness: Factor = 1.0
    version: str  # of ruffini: another one may make other samples

    @classmethod
    def of(cls, board: Board, *, n: int, shard_size: int, seed: int, error: PadError) -> Plan:
        """The plan of a board's twin as it is now.

        Raises
        ------
        InputError
            The board has no twin, or a number is out of range.
        """
        from ruffini.sim.settings import load_twin
        from ruffini.version import __version__

        load_twin(board)
        assert board.folder is not None
        try:
            return cls(
                board_toml=board.text, twin_toml=(board.folder / "twin.toml").read_text("utf-8"),
                n=n, shard_size=shard_size, seed=seed, scale_modulus=error.modulus, scale_poisson=error.poisson,
                scale_thickness=error.thickness, version=__version__,
            )  # fmt: skip
        except ValidationError as problem:
            first = problem.errors()[0]
            raise InputError(f"dataset: {first['loc'][0]}: {first['msg']}") from problem

    @property
    def n_shards(self) -> int:
        return -(-self.n // self.shard_size)

    def indices(self, shard: int) -> range:
        """Numbers of a shard's samples."""
        return range(shard * self.shard_size, min((shard + 1) * self.shard_size, self.n))

    def board(self) -> Board:
        return parse_board(self.board_toml, "the dataset's board.toml")

    def twin(self) -> TwinSettings:
        return parse_twin(self.twin_toml, "the dataset's twin.toml", self.board())

    def error(self) -> PadError:
        return PadError(self.scale_modulus, self.scale_poisson, self.scale_thickness)

    def sha256(self) -> str:
        return hashlib.sha256(self.model_dump_json().encode()).hexdigest()


def stored_plan(folder: Path) -> Plan | None:
    """The plan of a dataset that was begun, or None.

    Raises
    ------
    InputError
        There is a file that is no plan.
    """
    path = folder / PLAN_FILE
    if not path.is_file():
        return None
    try:
        return Plan.model_validate_json(readable(path).read_bytes())
    except ValidationError as error:
        raise InputError(f"{path}: not a dataset's plan: choose another --out") from error
