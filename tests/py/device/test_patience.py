"""RUFFINI_PATIENCE lengthens waits, and nothing that is written there shortens one."""

from __future__ import annotations

import pytest

from ruffini import patience


@pytest.mark.parametrize(
    ("told", "factor"),
    [(None, 1), ("4", 4), ("1.5", 1.5), ("", 1), ("long", 1), ("0", 1), ("-3", 1), ("nan", 1), ("inf", 1)],
)
def test_a_number_of_at_least_1_counts(told: str | None, factor: float, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUFFINI_PATIENCE")
    if told is not None:
        monkeypatch.setenv("RUFFINI_PATIENCE", told)
    assert patience._patience() == factor
