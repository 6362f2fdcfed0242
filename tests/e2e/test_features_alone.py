"""A log of features alone, no pictures: fitted, judged, flashed to the daemon on the twin; a force comes out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hang import HANG_S
from test_auto_boards import coarse
from test_bad_input import run_host

from ruffini.core import Pipeline
from ruffini.daemon import running_daemon
from ruffini.device import Connection
from ruffini.device.results import Wrench
from ruffini.sim.contact import Indenter
from ruffini.sim.pose import Pose
from ruffini.sim.scenario import Scenario
from ruffini.sim.serve import TwinServer
from ruffini.sim.unit import TwinUnit

Array = npt.NDArray[np.float64]

# Five kinds of contact: fewer make the fit state half of a force as uncertain.
TIPS = (("sphere", 2.0), ("sphere", 3.2), ("flat", 1.5), ("flat", 2.2), ("cone", 2.5))
PLACES_MM, OTHER_MM = ((-1.5, 1.0), (1.2, -2.0), (0.2, 0.4)), (0.6, -0.7)
N_FREE, N_STEPS, DEEPEST_M = 8, 7, 0.8e-3
MEASURED = 1  # Validity


def pressed(unit: TwinUnit, tip: tuple[str, float], place_mm: tuple[float, float]) -> tuple[list[Array], list[float]]:
    """Displacement and normal force of a touch, untouched at first."""
    rig = unit.rig()
    moved, force = [unit.at_rest()] * N_FREE, [0.0] * N_FREE
    rig.take(Indenter(tip[0], 1e-3 * tip[1]))
    for depth_m in np.linspace(0, DEEPEST_M, N_STEPS + 1)[1:]:
        rig.advance(Pose(1e-3 * place_mm[0], 1e-3 * place_mm[1], float(depth_m)))
        moved.append(rig.displacement.copy())
        force.append(float(rig.wrench()[2]))
    return moved, force


def write_features(unit: TwinUnit, path: Path) -> None:
    """What the board's core makes of pictures of touches, beside the force of a load cell, as a plain CSV."""
    renderer, rng, rows, time_s = unit.renderer(), np.random.default_rng(5), list[str](), 0.0
    with Pipeline(unit.board) as core:
        for _ in range(unit.board.pipeline.n_rest_frames + 1):
            core.process(renderer.image(unit.at_rest(), rng))
        names = [f"feature_{i}" for i in range(len(core.features()))]
        rows.append(",".join(["time", "fz", "touch", "tip", *names]))
        for number, (tip, place) in enumerate((tip, place) for tip in TIPS for place in PLACES_MM):
            for displacement, force in zip(*pressed(unit, tip, place), strict=True):
                core.process(renderer.image(displacement, rng))
                time_s += unit.frame_s
                read = force + rng.normal(0, 2e-3)
                rows.append(f"{time_s},{read},{number},{tip[0]} {tip[1]}," + ",".join(map(str, core.features())))
    path.write_text("\n".join(rows) + "\n")


class Played:
    """Frames of the live twin: some states, the last of which is held without end."""

    def __init__(self, moved: list[Array]) -> None:
        self._moved = moved

    def states(self, frame: int) -> tuple[Array, Array | None, None]:
        last = len(self._moved) - 1
        return self._moved[min(frame, last)], self._moved[min(frame - 1, last)] if frame else None, None


def test_a_log_of_features_alone_calibrates_the_twin(tmp_path: Path) -> None:
    board = coarse("fibre-skin", tmp_path)
    unit, folder = TwinUnit.build(board), str(tmp_path / "fibre-skin")
    log, file = tmp_path / "log.csv", tmp_path / "wrench.safetensors"
    write_features(unit, log)
    code, out, text = run_host("cal", "fit", str(log), "--board", folder, "--out", str(file), "--json")
    assert code == 0, text
    assert json.loads(out)["kinds"] == ["wrench"]
    code, out, text = run_host(
        "cal", "report", str(file), "--log", str(log), "--board", folder, "--out", str(tmp_path / "r.html"), "--json"
    )
    assert code == 0, text
    said = json.loads((tmp_path / "r.json").read_text())
    assert said["passed"]
    assert said["log"]["in_the_fit"]
    assert 0 < said["axes"]["Fz"]["rmse"] < 0.05 * said["axes"]["Fz"]["largest"]
    assert said["axes"]["Fx"]["rmse"] is None
    code, out, text = run_host(
        "cal", "check", "--grams", "30", "--rig", "sim", "--board", folder, "--calibration", str(file), "--json"
    )
    assert code == 0, text
    moved, force = pressed(unit, ("sphere", 2.6), OTHER_MM)  # a tip and a place that are not in the log
    frames = Played([unit.at_rest()] * 40 + moved)
    with (
        TwinServer(unit.renderer(), frames, Scenario(), tmp_path / "twin"),
        running_daemon(tmp_path / "fibre-skin", f"twin:{tmp_path / 'twin'}", tmp_path / "store") as port,
    ):
        code, out, text = run_host("cal", "flash", str(file), "--json", port=port)
        assert code == 0, text
        assert json.loads(out)["state"] == "active"
        with Connection(port) as sensor:
            sensor.subscribe(wrench=1)
            found = list[tuple[float, float]]()
            for frame, message in sensor.stream(timeout_s=HANG_S):
                if sensor.schema.type_name(frame.type) != "WRENCH":
                    continue
                wrench = Wrench.from_message(message)
                if (
                    wrench.sigma is not None
                    and wrench.validity[2] == MEASURED
                    and abs(wrench.values[2]) > 0.5 * abs(force[-1])
                ):
                    found.append((wrench.values[2], wrench.sigma[2]))
                if len(found) == 10:
                    break
    value, sigma = np.mean(found, axis=0)
    assert value == pytest.approx(force[-1], abs=max(3 * sigma, 0.01))
    assert 0.002 < sigma < 0.3 * abs(force[-1])
