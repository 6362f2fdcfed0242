"""The table of latencies: its row fits the document, and a computer without real-time rights measures, too."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
sys.path.append(str(ROOT / "tests" / "bench"))
import gels  # noqa: E402
import line_time  # noqa: E402


@pytest.mark.parametrize("is_real_time", [False, True])
def test_a_run_is_a_row_of_the_document(is_real_time: bool) -> None:
    own = {"p50": 1.7, "p99.9": 4.0} if is_real_time else {}
    latency = {"p50": 1.6, "p99": 3.5, "p99.9": 6.3, "largest": 70.0}
    row = line_time.row_of("idle", line_time.Run("", 3600, 1.4, latency, 2, own), "12345678")
    document = (ROOT / "docs" / "results" / "accuracy.md").read_text()
    assert row in gels.with_row(document, row, line_time.SECTION, line_time.COLUMNS)
    cells = ["| idle", "3600", "2", "1.4", "1.6", "3.5", "6.3", "70.0", *(["1.7", "4.0"] if own else ["", ""])]
    assert row.split(" | ")[: len(cells)] == cells
    assert row.count("|") == len(line_time.COLUMNS) + 1


def test_without_the_right_to_it_nothing_is_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(line_time.os, "sched_setscheduler", refuse)
    assert not line_time.take_priority(39)
