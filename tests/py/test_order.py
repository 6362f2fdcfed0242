"""How the suite runs: which modules begin, and that each worker is a session."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

CONFTEST = Path(__file__).parents[1] / "conftest.py"


def ordered(tests: list[str], module_seconds: dict[str, float], monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The modules of these tests in the order in which the suite runs them."""
    monkeypatch.delenv("RUFFINI_TEST_ORDER", raising=False)
    spec = importlib.util.spec_from_file_location("conftest_of_the_suite", CONFTEST)
    assert spec is not None
    assert spec.loader is not None
    suite = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(suite)
    items = [SimpleNamespace(path=Path(name)) for name in tests]
    suite.pytest_collection_modifyitems(SimpleNamespace(workerinput={"module_seconds": module_seconds}), items)
    return list(dict.fromkeys(item.path.name for item in items))


def test_the_longest_begin_and_of_those_that_never_ran_the_end_to_end_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    tests = ["py/test_few.py", "py/test_many.py", "py/test_many.py", "e2e/test_page.py", "py/test_slow.py"]
    assert ordered(tests, {}, monkeypatch) == ["test_page.py", "test_many.py", "test_few.py", "test_slow.py"]
    known = {"test_page.py": 3.0, "test_slow.py": 70.0, "test_many.py": 0.1, "test_few.py": 0.2}
    assert ordered(tests, known, monkeypatch) == ["test_slow.py", "test_page.py", "test_few.py", "test_many.py"]


@pytest.mark.skipif("PYTEST_XDIST_WORKER" not in os.environ, reason="no worker of pytest-xdist")
def test_a_worker_is_a_session() -> None:
    assert os.getsid(0) == os.getpid()
