"""The pictures of `make run`: which a board gets, and what is written on them."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.demo import pictures
from ruffini.demo.twin_pictures import pictures_of_twin
from ruffini.sim.settings import twin_names

N_FRAMES, PRESSED = 4, 2
SHOWN: dict[str, list[str]] = {name: [] for name in twin_names()} | {  # by what the board's stages write
    "gelslim": ["field", "depth"],
    "gelslim-dense": ["field", "depth"],
    "gelsight-mini": ["field"],
    "ftouch": ["depth"],
    "contact-glitter": ["contacts", "depth"],
    "eltac": ["contacts"],
    "stereo-fingertip": ["contacts"],
    "stereo-fingertip-thick": ["contacts"],
    "digit-tactile": ["depth"],
    "ninedtact": ["depth"],
}


class Drawn:
    """Texts of the figures that were saved."""

    def __init__(self) -> None:
        self.titles, self.labels, self.notes = list[str](), list[set[str]](), list[str]()

    def save(self, figure: Any, path: Path) -> Path:
        self.titles.append(figure.get_suptitle())
        self.labels.append({text for axis in figure.axes for text in (axis.get_xlabel(), axis.get_ylabel()) if text})
        self.notes += [text.get_text() for axis in figure.axes for text in axis.texts]
        figure.canvas.draw()
        return path


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> Drawn:
    found = Drawn()
    monkeypatch.setattr(pictures, "_save", found.save)
    return found


def contact(x_mm: float, y_mm: float, force_z: float) -> Any:
    return SimpleNamespace(center=(1e-3 * x_mm, 1e-3 * y_mm), force=np.array([np.nan, np.nan, force_z]))


def press_of(name: str, folder: Path, contacts: list[Any]) -> tuple[dict[str, dict[int, Any]], dict[str, Any]]:
    """A recording with one pressed frame, and results as if it had come over the line."""
    board = find_board(name)
    grid, camera = board.grid, board.camera
    (folder / "recording" / "frames").mkdir(parents=True)
    frame = np.full((camera.height_px, camera.width_px, 3), 90, np.uint8)
    for i in range(N_FRAMES):
        cv2.imwrite(str(folder / "recording" / "frames" / f"{i:06d}.png"), frame)
    force = np.zeros((N_FRAMES, grid.n_y, grid.n_x, 3))
    force[PRESSED, grid.n_y // 2, grid.n_x // 2] = 0.3, 0.1, -2.0
    truth = {
        "time_s": np.arange(N_FRAMES) * 0.1, "force": force, "displacement": 1e-4 * force,
        "wrench": np.concatenate([force.sum(axis=(1, 2)), np.zeros((N_FRAMES, 3))], axis=1),
        "touch": np.where(np.arange(N_FRAMES) == PRESSED, 0, -1),
    }  # fmt: skip
    rows, columns = board.observed
    depth = np.full((camera.height_px // board.depth.step_px, camera.width_px // board.depth.step_px), np.nan)
    if "depth" in SHOWN[name]:
        depth = np.zeros_like(depth)
        depth[5, 5] = -1e-3
    results: dict[str, dict[int, Any]] = {
        "FIELD": {i: SimpleNamespace(raw_force=force[i][rows, columns]) for i in range(N_FRAMES)},
        "CONTACTS": {i: SimpleNamespace(contacts=contacts if i == PRESSED else []) for i in range(N_FRAMES)},
        "DEPTH": {PRESSED: SimpleNamespace(depth=depth, frame=PRESSED, step_px=board.depth.step_px)},
    }
    return results, truth


@pytest.mark.parametrize("name", SHOWN)
def test_every_board_gets_the_pictures_of_what_it_measures(name: str, drawn: Drawn, tmp_path: Path) -> None:
    results, truth = press_of(name, tmp_path, [contact(0, 0, -1.9)])
    made = pictures_of_twin(find_board(name), tmp_path, results, truth, f"{name}, SIMULATED")
    assert [path.stem for path in made] == SHOWN[name]
    assert all(title.startswith(f"{name}, SIMULATED") for title in drawn.titles)
    assert all({"mm" in label or "mN" in label or "micrometres" in label for label in labels} == {True}
               for labels in drawn.labels)  # fmt: skip
    is_field, shows_frame = "field" in SHOWN[name], {"field", "contacts"} & set(SHOWN[name])
    assert ("1.90 N\ntrue 2.02 N" in drawn.notes) == ("contacts" in SHOWN[name] and not is_field)
    if not shows_frame:  # the camera image stands beside the depth
        assert len(drawn.labels) == len(SHOWN[name])


def test_a_force_only_after_the_touch_is_drawn_all_the_same(drawn: Drawn, tmp_path: Path) -> None:
    results, truth = press_of("eltac", tmp_path, [contact(0, 0, -0.2)])
    truth["touch"][:] = -1
    assert pictures_of_twin(find_board("eltac"), tmp_path, results, truth, "eltac, SIMULATED")


def test_contacts_beside_each_other_have_one_number_and_others_their_own(drawn: Drawn, tmp_path: Path) -> None:
    far = [contact(-4, 0, -1.0), contact(4, 0, -0.5), contact(90, 30, -3.0)]
    results, truth = press_of("eltac", tmp_path, far)
    truth["force"][PRESSED, -4, -4] = 0.0, 0.0, -3.5
    pictures_of_twin(find_board("eltac"), tmp_path, results, truth, "eltac, SIMULATED")
    assert sorted(drawn.notes) == ["1.50 N\ntrue 2.02 N", "3.00 N\ntrue 3.50 N"]


def test_a_frame_whose_force_is_not_valid_is_shown_only_if_no_other_is(drawn: Drawn, tmp_path: Path) -> None:
    results, truth = press_of("stereo-fingertip", tmp_path, [contact(0, 0, np.nan)])
    pictures_of_twin(find_board("stereo-fingertip"), tmp_path, results, truth, "SIMULATED")
    results["CONTACTS"][1] = SimpleNamespace(contacts=[contact(1, 1, -0.7)])
    pictures_of_twin(find_board("stereo-fingertip"), tmp_path, results, truth, "SIMULATED")
    assert [note.splitlines()[0] for note in drawn.notes] == ["no force", "0.70 N"]


def test_a_sensor_that_reports_no_touch_is_still_shown(drawn: Drawn, tmp_path: Path) -> None:
    results, truth = press_of("eltac", tmp_path, [])
    pictures_of_twin(find_board("eltac"), tmp_path, results, truth, "eltac, SIMULATED")
    assert drawn.titles == ["eltac, SIMULATED: touches; no touch was reported"]
