"""The firmware's decoders and the host's, on the same mutated bytes: a short run; a million in `make fuzz`."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

from ruffini.native import native_folder

SCRIPT = Path(__file__).parents[2] / "fuzz" / "differential.py"


@pytest.fixture
def differential() -> ModuleType:
    if not (native_folder() / "libruffini_decoders.so").exists():
        pytest.skip("needs libruffini_decoders.so, which is built with the daemon's messages")
    spec = importlib.util.spec_from_file_location("differential", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_both_say_the_same_of_twenty_thousand_inputs(differential: ModuleType) -> None:
    seen = differential.Differential(seed=2).run(20_000)
    # Were hardly any accepted, this would prove little.
    for what in ("line, with frames", "message, accepted", "node values, accepted"):
        assert seen[what] > 500


def test_a_decoder_that_takes_one_flag_too_many_is_seen(
    differential: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ruffini.wire.framing.KNOWN_FLAGS", 15)
    with pytest.raises(AssertionError, match="the firmware says"):
        differential.Differential(seed=2).run(100_000)
