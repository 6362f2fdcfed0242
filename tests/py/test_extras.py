"""What a person is told to install is what host/pyproject.toml and the README name."""

from __future__ import annotations

from pathlib import Path

import pytest
import tomllib

from ruffini.extras import EXTRAS, missing

HOST = Path(__file__).parents[2] / "host"


def test_the_extras_are_those_of_the_project() -> None:
    named = tomllib.loads((HOST / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert {name: list(packages) for name, packages in EXTRAS.items()} == {k: v for k, v in named.items() if k != "dev"}


@pytest.mark.parametrize("extra", EXTRAS)
def test_the_sentence_and_the_readme_name_each_package(extra: str) -> None:
    install = str(missing("it", extra)).partition(": ")[2]
    assert install == "pip install " + " ".join(f"'{p}'" for p in EXTRAS[extra])
    (row,) = [line for line in (HOST / "README.md").read_text().splitlines() if line.startswith(f"| `[{extra}]`")]
    assert f"`{install}`" in row
