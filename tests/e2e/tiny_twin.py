"""A twin of the tiny sensor, and a calibration that was fitted to it."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tiny_sensor import Sensor, write_board

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.calibrate.contact_noise import fit_contact_noise, linear_pressure
from ruffini.calibrate.pad_view import Pinhole
from ruffini.calibrate.photometric import Choice, collect_samples, fit_model, tabulate
from ruffini.calibrate.presses import load_presses
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.recording import record_balls
from ruffini.sim.scenario import Scenario
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit

N_UNTOUCHED = 120
# A node is four times as large as on the board that the threshold is of, so it feels four times the force.
CHANGES = {"threshold_un = 3000": "threshold_un = 12000"}


@dataclass(frozen=True)
class Twin:
    """A tiny twin and a calibration that fits it."""

    unit: TwinUnit
    calibration: bytes

    @property
    def board(self) -> Board:
        return self.unit.board


def make_twin(sensor: Sensor, root: Path) -> Twin:
    """Of the same pad as `sensor`; `root` keeps its board and its presses."""
    # A slow camera: simulated time passes in fewer frames.
    name = sensor.board.name
    changes = {**CHANGES, 'name = "tiny"': f'name = "{name}"', "rate_mhz = 60000": "rate_mhz = 20000"}
    folder = write_board(root / name, changes)
    shutil.copy(find_board("gelslim").folder / "twin.toml", folder)
    board = find_board(folder)
    pad, camera = board.pad, board.camera
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=16, n_cells_y=13, layers=(0.2, 0.3, 0.5),
    )  # fmt: skip
    unit = TwinUnit(board, load_twin(board), model, surface_compliance(model))
    record_balls(unit, 16, root / "balls", ball_mm=9.0, seed=1)
    pinhole = Pinhole(
        camera.focal_mpx / 1e3, camera.center_x_mpx / 1e3, camera.center_y_mpx / 1e3, camera.standoff_um / 1e3
    )
    colours = fit_model(collect_samples(load_presses(root / "balls"), pinhole), Choice(unmix_order=2, stiffness=1e-5))
    file = container.unpack(sensor.calibration)  # the same pad: its operator fits
    file = container.pack({**file.tensors, **tabulate(colours)}, file.metadata)
    noise = fit_contact_noise(linear_pressure(board, file, untouched(unit)), board.pipeline.n_rest_frames)
    return Twin(unit, container.pack({**file.tensors, **noise.tensors()}, file.metadata).data)


def untouched(unit: TwinUnit) -> Iterator[np.ndarray]:
    """Frames of a twin that nothing touches."""
    renderer, scenario, rest = unit.renderer(), Scenario(seed=1), unit.at_rest()
    return (scenario.picture(renderer, i, rest, rest, None) for i in range(N_UNTOUCHED))
