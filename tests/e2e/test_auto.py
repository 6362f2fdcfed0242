"""`ruffini cal auto` on a bench without hardware: collected, fitted, judged where nothing was pressed; goes on after a
stop; what fails its gates is not flashed."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tiny_twin import Twin

from ruffini.boards import Board
from ruffini.calibrate import container, gates
from ruffini.calibrate.auto.page import table_of
from ruffini.calibrate.auto.run import Auto, Opened, Site
from ruffini.calibrate.auto.truth import Truth
from ruffini.calibrate.container import CalibrationFile
from ruffini.demo.twin_session import TwinOptions, limits_of, open_simulated
from ruffini.errors import RefusedError
from ruffini.estimators.material import stage as material
from ruffini.estimators.material.fit import MaterialFit, fit_material
from ruffini.estimators.material.model import MaterialLog
from ruffini.estimators.operator.task import TASK as FORCES
from ruffini.estimators.task import Counts
from ruffini.rig.program import Span
from ruffini.rig.session import ready_bench

SPAN = Span(0.004, 0.003, 0.0008, 0.0003)
COUNTS = Counts(balls=0, fitted=10, judged=2, error_touches=0)


def auto(twin: Twin, folder: Path, opened: list[str], *, force: bool) -> Auto:
    """A run whose colours are there already, as after a stop; so small a camera is not held to the gates (`force`)."""

    @contextlib.contextmanager
    def site(program: str, calibration: CalibrationFile | None, seed: int) -> Iterator[Opened]:
        assert calibration is not None
        opened.append(calibration.sha256.hex())
        with contextlib.ExitStack() as stack:
            options, truth = TwinOptions(seed=seed, is_hurried=True), Truth()
            simulated = open_simulated(stack, twin.board, program, options, twin.unit)
            simulated.twin.twin.listeners.append(truth.note)
            simulated.parts.sensor.flash(calibration.data)
            limits = limits_of(twin.board, SPAN, 6.0)
            few_pictures = simulated.parts.pace._replace(image_bytes_per_s=1e5)  # the colours are there already
            parts = replace(simulated.parts, pace=few_pictures)
            yield Opened(stack.enter_context(ready_bench(parts, twin.board, limits)), truth)

    first = container.unpack(twin.calibration)
    container.write(folder / "before.safetensors", first)
    return Auto(twin.board, FORCES, Site(site, SPAN, None, True), folder, COUNTS, 1, lambda _: None, force=force)


@pytest.fixture
def _fitted_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds of the fit are spent once: the run that goes on has the log of the run before."""
    made: list[tuple[MaterialLog, MaterialFit]] = []

    def fit_once(board: Board, log: MaterialLog, *arguments: Any, **options: Any) -> MaterialFit:
        if not made:
            made.append((log, fit_material(board, log, *arguments, **options)))
        assert np.array_equal(made[0][0].wrench, log.wrench)
        return made[0][1]

    monkeypatch.setattr(material, "fit_material", fit_once)


@pytest.mark.usefixtures("_fitted_once")
def test_collects_fits_flashes_and_judges_then_goes_on_where_it_was(
    bench_twin: Twin,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    opened: list[str] = []
    result = json.loads(json.dumps(auto(bench_twin, tmp_path, opened, force=True).run()))
    first = container.unpack(bench_twin.calibration).sha256.hex()
    assert opened == [first, first, result["sha256"]]
    assert result["before"]["against"] == result["after"]["against"] == "the twin's truth"
    assert result["after"]["touches"] == 2
    assert result["after"]["force_rmse_n"] < 0.15 * result["after"]["largest_force_n"]
    for page in ("report.html", "auto.html"):
        assert "SIMULATED" in (tmp_path / page).read_text()
    assert "error_ms" in result["clock"], result["clock"]
    assert table_of([tmp_path])[1].splitlines()[2].startswith("| tiny | 0, 10, 2 |")
    monkeypatch.setattr(gates, "MAX_ERROR", 0.0)
    opened.clear()
    with pytest.raises(RefusedError, match=r"not flashed, what is in force stays \(.*error: "):
        auto(bench_twin, tmp_path, opened, force=False).run()
    assert opened == []  # all that it needed was there, and nothing was flashed
