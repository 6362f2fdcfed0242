"""What a sensor with targets says when something is wrong with it: flagged within three frames, on the twin."""

from __future__ import annotations

import shutil

import numpy as np
import numpy.typing as npt
import pytest
from kept import kept

from ruffini.bench import picture_faults as faults
from ruffini.boards import Board, find_board
from ruffini.core import Pipeline
from ruffini.estimators.wrench.target_geometry import TargetGeometry
from ruffini.sim.optics.conditions import TrayPose
from ruffini.sim.programs import Load, Rest
from ruffini.sim.scenario import Scenario
from ruffini.sim.story import play
from ruffini.sim.units import build_unit

Picture = npt.NDArray[np.uint8]
MARKERS_LOST, DARK, LIGHT = 8, 64, 1024
WITHIN = 3
LOAD = np.array([0.3, -0.2, -2.0, 3e-3, -2e-3, 1e-3])  # N and N m


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Board:
    """Its tray is loaded, so the pad on it needs few elements."""
    folder = tmp_path_factory.mktemp("board") / "ftouch"
    shutil.copytree(find_board("ftouch").folder, folder)
    with (folder / "twin.toml").open("a") as twin:
        twin.write("\n[mesh]\ncells_x = 6\ncells_y = 5\n")
    return find_board(folder)


def shown(board: Board, *, n_rest: int, n_loaded: int, **fault: object) -> list[Picture]:
    """Frames of a rest and a held load, with a fault from the first loaded frame on."""
    return kept(drawn, board, n_rest, n_loaded, fault)[0]


def drawn(board: Board, n_rest: int, n_loaded: int, fault: dict[str, object]) -> tuple[list[Picture], list[TrayPose]]:
    """Those frames, and where the tray was."""
    faults = [{"first_frame": n_rest, "n_frames": n_loaded, **fault}] if fault else []
    scenario = Scenario.model_validate({"seed": 4, "fault": faults})
    unit = build_unit(board)
    renderer = unit.renderer()
    story = [Rest(n_rest), Load(np.repeat(LOAD[None], n_loaded, axis=0), [True] * n_loaded)]
    pictures, trays = [], []
    for frame, moment in enumerate(play(unit, story)):
        assert moment.tray is not None
        pictures.append(scenario.picture(renderer, frame, moment.displacement, None, moment.tray))
        trays.append(moment.tray)
    return pictures, trays


def flags_after(board: Board, pictures: list[Picture], n_rest: int) -> list[int]:
    """Flags of every frame after the rest, without those of a board that has no calibration."""
    with Pipeline(board) as core:
        said = [core.process(picture) for picture in pictures]
    return [frame.flags & (MARKERS_LOST | DARK | LIGHT) for frame in said[n_rest:]]


def test_a_load_is_no_fault(board: Board) -> None:
    n_rest = board.pipeline.n_rest_frames
    assert flags_after(board, shown(board, n_rest=n_rest, n_loaded=4), n_rest) == [0] * 4


def test_light_that_tilts_as_under_a_tilted_tray_is_no_fault(board: Board) -> None:
    """1 % brighter on one side, 1 % darker on the other, for four windows of the lamps' map of other boards."""
    n_rest = board.pipeline.n_rest_frames
    rest = shown(board, n_rest=n_rest, n_loaded=0)
    tilt = 1 + 0.01 * np.linspace(-1, 1, board.camera.width_px)[None, :, None]
    tilted = [np.clip(np.rint(picture * tilt), 0, 255).astype(np.uint8) for picture in rest]
    pictures = [*rest, *(tilted[i % n_rest] for i in range(64))]
    assert flags_after(board, pictures, n_rest) == [0] * 64


@pytest.mark.parametrize(
    ("fault", "flag"),
    [
        ({"kind": "lens_cap"}, DARK),
        ({"kind": "light_leak", "level_1e3": 600}, LIGHT),
        ({"kind": "led_off", "leds": [0, 1, 2]}, LIGHT),
    ],
)
def test_a_fault_is_flagged_within_three_frames(board: Board, fault: dict[str, object], flag: int) -> None:
    n_rest = board.pipeline.n_rest_frames
    flags = flags_after(board, shown(board, n_rest=n_rest, n_loaded=WITHIN, **fault), n_rest)
    assert any(each & flag for each in flags), flags


@pytest.mark.parametrize("black", [-14, 8])
def test_another_black_level_is_flagged_under_a_load(board: Board, black: int) -> None:
    """It changes the area at which a target's edge is found, and so the force."""
    n_rest = board.pipeline.n_rest_frames
    pictures = shown(board, n_rest=n_rest, n_loaded=4)
    off = faults.toned(black=black)(pictures[-1], np.random.default_rng(1))
    with Pipeline(board) as core:
        core.set_live()
        good = [core.process(picture) for picture in pictures]
        assert not any(frame.flags & LIGHT for frame in good)
        assert core.process(off).flags & LIGHT


def test_a_removed_and_a_half_covered_target_are_flagged_at_once(board: Board) -> None:
    n_rest = board.pipeline.n_rest_frames
    pictures = shown(board, n_rest=n_rest, n_loaded=3)
    with Pipeline(board) as core:
        for picture in pictures[: n_rest + 1]:
            core.process(picture)
        x, y, radius = (int(core.targets()[0, k]) // 65536 for k in (4, 5, 4))
        radius = 40
        removed, half = pictures[-2].copy(), pictures[-1].copy()
        removed[y - radius : y + radius, x - radius : x + radius] = removed[y + radius + 4, x]
        half[y - radius : y, x - radius : x + radius] = half[y + radius + 4, x]
        for picture in (removed, half):
            said = core.process(picture)
            assert said.flags & MARKERS_LOST
            assert core.targets()[:, 8].tolist() == [1, 0, 0]


def test_shifts_and_areas_are_those_of_the_trays_pose(board: Board) -> None:
    """Against perspective of the twin's true pose: 0.05 px and 0.2 % of the area, under noise and JPEG."""
    n_rest, n_loaded = board.pipeline.n_rest_frames, 6
    pictures, trays = kept(drawn, board, n_rest, n_loaded, {})
    poses = [[*(1e3 * v for v in tray.shift_m), *tray.turn_rad] for tray in trays[n_rest:]]
    with Pipeline(board) as core:
        seen = []
        for frame, picture in enumerate(pictures):
            core.process(picture)
            if frame >= n_rest:
                seen.append(core.features())
        area = core.targets()[:, 2] / 256
    expected = TargetGeometry(board).features(np.array(poses)).reshape(n_loaded, -1, 3)
    off = np.array(seen).reshape(n_loaded, -1, 3) - expected
    assert np.abs(expected[:, :, :2]).max() > 2 * 65536  # a load that moves them
    assert np.abs(off[:, :, :2]).max() < 0.05 * 65536
    assert (np.abs(off[:, :, 2] / 256) < 2e-3 * area).all()
