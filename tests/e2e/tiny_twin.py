"""A twin of the tiny sensor, and a calibration that was fitted to it."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from kept import kept
from tiny_sensor import Sensor, write_board

from ruffini.boards import Board, find_board
from ruffini.calibrate import container
from ruffini.estimators.photometric.fit import Choice, collect_samples, fit_model, tabulate
from ruffini.estimators.photometric.pad_view import Pinhole
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.threshold.fit import fit_contact_noise, linear_pressure
from ruffini.sim.pad import PadModel, surface_compliance
from ruffini.sim.recording import record_balls
from ruffini.sim.scenario import Scenario
from ruffini.sim.settings import load_twin
from ruffini.sim.unit import TwinUnit

Tensors = dict[str, npt.NDArray[np.generic]]

N_UNTOUCHED = 120
RATE_MHZ = 20000  # a slow camera: simulated time passes in fewer frames
OF_THIS_RUN = ("created_utc", "inputs_sha256")  # of a calibration's manifest
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
    """Of the same pad as `sensor`; `root` keeps its board."""
    unit = _unit(sensor.board.name, root)
    file = container.unpack(sensor.calibration)  # the same pad: its operator fits
    same = {key: said for key, said in file.metadata.items() if key not in OF_THIS_RUN}
    tables = kept(fitted_tables, sensor.board.name, file.tensors, same)
    return Twin(unit, container.pack({**file.tensors, **tables}, file.metadata).data)


def slowed(twin: Twin, root: Path) -> Twin:
    """The same with a camera of half the rate; `root` keeps its board."""
    return Twin(_unit(twin.board.name, root, twin.board.camera.rate_mhz // 2), twin.calibration)


def _unit(name: str, root: Path, rate_mhz: int = RATE_MHZ) -> TwinUnit:
    changes = {**CHANGES, 'name = "tiny"': f'name = "{name}"', "rate_mhz = 60000": f"rate_mhz = {rate_mhz}"}
    folder = write_board(root / name, changes)
    shutil.copy(find_board("gelslim").folder / "twin.toml", folder)
    board = find_board(folder)
    pad = board.pad
    model = PadModel(
        pad.size_x_um * 1e-6, pad.size_y_um * 1e-6, pad.thickness_um * 1e-6, pad.modulus_pa,
        pad.poisson_1e4 * 1e-4, n_cells_x=16, n_cells_y=13, layers=(0.2, 0.3, 0.5),
    )  # fmt: skip
    return TwinUnit(board, load_twin(board), model, kept(surface_compliance, model))


def fitted_tables(name: str, tensors: Tensors, metadata: dict[str, str]) -> Tensors:
    """Colours and threshold of the twin whose operator is in `tensors`, fitted to balls and to its rest."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        unit = _unit(name, root)
        board, camera = unit.board, unit.board.camera
        record_balls(unit, 16, root / "balls", ball_mm=9.0, seed=1)
        pinhole = Pinhole(
            camera.focal_mpx / 1e3, camera.center_x_mpx / 1e3, camera.center_y_mpx / 1e3, camera.standoff_um / 1e3
        )
        samples = collect_samples(load_presses(root / "balls"), pinhole)
    colours = tabulate(fit_model(samples, Choice(unmix_order=2, stiffness=1e-5)))
    file = container.pack({**tensors, **colours}, {**container.base_metadata(board), **metadata})
    noise = fit_contact_noise(linear_pressure(board, file, untouched(unit)), board.pipeline.n_rest_frames)
    return {**colours, **noise.tensors()}


def untouched(unit: TwinUnit) -> Iterator[np.ndarray]:
    """Frames of a twin that nothing touches."""
    renderer, scenario, rest = unit.renderer(), Scenario(seed=1), unit.at_rest()
    return (scenario.picture(renderer, i, rest, rest, None) for i in range(N_UNTOUCHED))
