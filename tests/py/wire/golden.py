"""The golden bytes of proto/vectors."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parents[3] / "proto" / "vectors"


def read_vectors(name: str) -> list[list[str]]:
    """The lines of a file, each cut into its fields."""
    lines = (FOLDER / name).read_text().splitlines()
    return [line.split(" | ") for line in lines if line and not line.startswith("#")]
