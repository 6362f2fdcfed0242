"""The tests that `make mutants` runs on each planted bug exist, and each C++ test file has a program."""

import importlib.util
import sys
from pathlib import Path

import tomllib

FOLDER = Path(__file__).parents[2] / "tests" / "mutants"


def test_each_layer_is_there() -> None:
    spec = importlib.util.spec_from_file_location("mutants", FOLDER / "mutants.py")
    assert spec is not None
    assert spec.loader is not None
    mutants = sys.modules["mutants"] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutants)
    plan = tomllib.loads((FOLDER / "seeded_bugs.toml").read_text())
    layers = {bug["layer"] for bug in plan["bug"]}
    assert layers
    for name in layers:
        assert mutants.layer_of(name, plan["layers"]).command
