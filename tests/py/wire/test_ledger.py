"""The ledger of long runs adds up, and what is committed can be read."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import tomllib

TESTS = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def ledger() -> ModuleType:
    spec = importlib.util.spec_from_file_location("ledger", TESTS / "ledger.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_executions_add_up_by_target_and_the_rest_stays(ledger: ModuleType) -> None:
    rows: list[dict[str, Any]] = [{"target": "frame", "executions": 5, "commit": "a"}]
    ledger.add(rows, "frame", 7, "b")
    ledger.add(rows, "slots", 1, "b")
    tables = {"simulation": [{"hours": 2.5, "commit": "a"}], "fuzz": rows}
    assert tomllib.loads(ledger.written(tables)) == {
        "simulation": [{"hours": 2.5, "commit": "a"}],
        "fuzz": [
            {"target": "frame", "executions": 12, "commit": "b"},
            {"target": "slots", "executions": 1, "commit": "b"},
        ],
    }


def test_the_committed_ledger_is_as_the_command_writes_it(ledger: ModuleType) -> None:
    text = ledger.LEDGER.read_text()
    assert ledger.written(tomllib.loads(text)) == text
