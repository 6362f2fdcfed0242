"""First newtons: a person, a kitchen scale under the sensor, and a pad that is not what its board file says."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from test_bench_file import FEW_PICTURES, GRAMS_A_NEWTON, LIMITS, Desk, held
from tiny_twin import Twin

from ruffini import host_clock
from ruffini.cli import main
from ruffini.rig.emulated_person import EmulatedPerson
from ruffini.rig.log_file import Log, read_log
from ruffini.sim.unit import TwinUnit

STIFFER = 1.2  # the pad's true modulus over the board's
SCALE = '[reference]\nkind = "weight"\nsigma_g = 2.0\n'


class Truth:
    """The twin's own force, by time, and the number of its newest frame."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float]] = []
        self.frame = 0

    def note(self, frame: int, wrench: np.ndarray) -> None:
        self.frame = frame
        self.rows.append((host_clock.now(), float(wrench[2])))

    def held(self, facts: dict[str, float]) -> float:
        """Mean of a hold, N pressing."""
        return -float(np.mean([f for t, f in self.rows if facts["held_host_s"] < t < facts["lifted_host_s"]]))


def test_presses_on_a_scale_find_a_pad_that_is_stiffer_than_its_board_says(
    bench_twin: Twin, tmp_path, monkeypatch, capsys
) -> None:
    monkeypatch.setattr("ruffini.rig.session.Pace.__new__.__defaults__", (None, 15.0, 8.0, 30.0, FEW_PICTURES))
    unit = bench_twin.unit
    model = replace(unit.model, modulus_pa=unit.model.modulus_pa * STIFFER)
    stiff = TwinUnit(unit.board, unit.twin, model, unit.compliance / STIFFER)
    person, truth = EmulatedPerson(1), Truth()
    monkeypatch.setattr("ruffini.rig.person.TerminalPerson", lambda *_, **__: person)
    desk = Desk(Twin(stiff, bench_twin.calibration), tmp_path, person, capsys)
    desk.bench.twin.listeners.append(truth.note)

    def run(*words: object) -> dict[str, Any]:
        monkeypatch.setattr(sys, "argv", ["ruffini", *map(str, words), "--json"])
        capsys.readouterr()
        code = main()
        text, error = capsys.readouterr()
        assert code == 0, error
        return json.loads(text)

    def collected(out: Path, *words: object) -> Log:
        (tmp_path / "rig.toml").write_text("schema = 1\n" + SCALE + LIMITS)
        board, rig = desk.twin.board.folder, tmp_path / "rig.toml"
        run("--port", desk.port, "cal", "collect", "--board", board, "--rig", rig, "--out", out, *words)
        return read_log(out)

    with desk.running():
        start_s = host_clock.now()
        _, log = desk.collect(monkeypatch, SCALE + LIMITS, "--program", "scale", "--grams", "100,200,300", "--n", 15,
                              "--tip", "ball")  # fmt: skip
        took_s = host_clock.now() - start_s
        assert log.facts["tip"] == {"name": "ball"}
        before, typed = errors(log, truth)
        port, board, file = ("--port", desk.port), ("--board", desk.twin.board.folder), tmp_path / "new.safetensors"
        run("cal", "fit", tmp_path / "log.h5", *board, "--previous", tmp_path / "calibration", "--out", file,
                     "--skip", "noise", "--skip", "photometric", "--touches", 0)  # fmt: skip
        flashed = run(*port, "cal", "flash", file)
        words = ("--program", "scale", "--grams", "50,100", "--n", 4, "--seed", 7)
        after, _ = errors(collected(tmp_path / "after.h5", *words), truth)
        undone = run(*port, "cal", "undo")
    print(
        f"{len(log.touches)} presses in {took_s:.0f} s of the bench's time; off the truth: typed at most "
        f"{100 * np.abs(typed).max():.1f} %, the sensor's force {100 * np.abs(before).mean():.1f} % before and "
        f"{100 * np.abs(after).mean():.1f} % after (at most {100 * np.abs(after).max():.1f} %)"
    )
    assert flashed["state"] == "active"
    assert undone["replaced_sha256"] == flashed["sha256"]
    assert np.abs(typed).max() < 0.05
    assert np.mean(before) < -0.1
    assert np.abs(after).mean() < 0.08


def errors(log: Log, truth: Truth) -> tuple[np.ndarray, np.ndarray]:
    """Of each press: the sensor's force and the typed one over the truth, less 1."""
    true_n = np.array([truth.held(touch.facts) for touch in log.touches])
    said_n = np.array([-held(touch, "stream_wrench", "stream_host_s") for touch in log.touches])
    typed_n = np.array([touch.facts["typed_g"] / GRAMS_A_NEWTON for touch in log.touches])
    return said_n / true_n - 1, typed_n / true_n - 1
