"""A glowing skin over a real serial line: drawn pictures of the real board, the real ruffinid, contacts and ageing."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hang import HANG_S
from tiny_sensor import Sensor, start

from ruffini.boards import find_board
from ruffini.device import Connection
from ruffini.estimators.skin.fit import N_KINDS, SkinFit, taxel_file
from ruffini.estimators.skin.gain import no_gain
from ruffini.estimators.skin.openings import TubeView, find_openings, lattice_mm
from ruffini.estimators.skin.places import PlaceFit
from ruffini.estimators.skin.reach import REACH_SIZE, REACH_STEP_MM
from ruffini.estimators.skin.response import ForceFit, layout_of
from ruffini.estimators.skin.spread import Spread

Array = npt.NDArray[np.float64]

BOARD = find_board("eltac")
LENS = TubeView(950.0, 160.0, -0.3, 0.2, 647.6, 357.5, 40.0, 0.0)
N_REST, N_PRESSED = 8, 4
PLACE_MM = np.array([-78.5, 12.0])  # off the pyramid at 15 mm
AGED = 0.7  # of the calibration's light
DARK, INVALID, VALID = 64, 3, 1
FAR_MM = (9.0, 15.0)  # along x and y a touch falls off to 1 / e


def sinks() -> Array:
    off = np.abs(lattice_mm(BOARD) - PLACE_MM)
    return np.exp(-off[:, 0] / FAR_MM[0] - off[:, 1] / FAR_MM[1])


def picture(ratio: Array, rng: np.random.Generator, light: float = 1.0) -> npt.NDArray[np.uint8]:
    level = np.zeros((BOARD.camera.height_px, BOARD.camera.width_px))
    for (x, y), r in zip(LENS.project(lattice_mm(BOARD)), ratio, strict=True):
        cv2.circle(level, (round(x), round(y)), 4, 50 * light * (1 + r), -1)
    colours = level[..., None] * np.array([1.0, 0.8, 0.5])
    noise = rng.normal(0, 0.5, colours.shape) * (level[..., None] > 0)
    return np.clip(np.round(colours + noise), 0, 255).astype(np.uint8)


def calibration() -> bytes:
    """A law that falls off as the touch is drawn, made with more light than the skin has now."""
    untouched = picture(np.zeros(len(lattice_mm(BOARD))), np.random.default_rng(1), 1 / AGED)
    light = untouched[..., :2].sum(axis=-1, dtype=np.float64)
    openings = find_openings(BOARD, light, LENS.project(lattice_mm(BOARD)))
    layout = layout_of(BOARD, openings.places_mm)
    force = ForceFit(4.0, 0.5, 0.12, np.zeros(4), no_gain())
    shift = np.zeros((openings.n_taxels, 2, 4))
    shift[:, :, 1] = 4.0
    x, y = np.meshgrid(*(np.arange(n) * REACH_STEP_MM for n in REACH_SIZE))
    reach = np.maximum(np.exp(-x / FAR_MM[0] - y / FAR_MM[1]), 0.002)
    spread = [Spread(0.13, 0.065, 1.3, 1.3)] * N_KINDS
    fit = SkinFit(
        LENS,
        openings,
        layout,
        force,
        PlaceFit(layout.places_mm, shift),
        reach,
        0.3,
        2.0,
        spread,
        {},
        openings.base_q2(light),
    )
    return taxel_file(BOARD, fit).data


@pytest.fixture(scope="module")
def glowing(tmp_path_factory: pytest.TempPathFactory) -> Sensor:
    """Rest, a touch that grows, and a frame with the lens covered."""
    folder, rng = tmp_path_factory.mktemp("skin") / "recording", np.random.default_rng(2)
    (folder / "frames").mkdir(parents=True)
    for i in range(N_REST + N_PRESSED + 1):
        strength = max(i - N_REST + 1, 0) / N_PRESSED
        frame = picture(np.expm1(1.2 * strength * sinks()), rng)
        if i == N_REST + N_PRESSED:
            frame[:] = 0
        cv2.imwrite(str(folder / "frames" / f"{i:04d}.png"), frame)
    (folder / "recording.toml").write_text(f'simulated = true\nboard = "{BOARD.name}"\nrate_mhz = 30000\n')
    assert BOARD.folder is not None
    return Sensor(BOARD, BOARD.folder, folder, calibration())


def test_a_touch_arrives_with_place_force_and_age_and_a_covered_lens_is_flagged(
    glowing: Sensor, tmp_path: Path
) -> None:
    contacts, wrenches, status = [], [], None
    options = ("--lockstep", "--wait-for-host", "--linger")  # the line stays until STATUS was answered
    with start(glowing, tmp_path, *options) as daemon, Connection(daemon.port) as host:
        host.flash(glowing.calibration)
        host.subscribe(contacts=1, wrench=1)
        for frame, message in host.stream(timeout_s=HANG_S):
            name = host.schema.type_name(frame.type)
            contacts += [message] if name == "CONTACTS" else []
            wrenches += [message] if name == "WRENCH" else []
            if len(contacts) == N_REST + N_PRESSED and status is None:
                host._send("STATUS")
            status = message if name == "STATUS" else status
            if status is not None and len(contacts) == len(wrenches) == N_REST + N_PRESSED + 1:
                break
    assert len(contacts) == N_REST + N_PRESSED + 1
    assert [len(m.contacts) for m in contacts[:N_REST]] == [0] * N_REST
    forces = []
    for message in contacts[N_REST + 1 : N_REST + N_PRESSED]:
        [one] = message.contacts
        assert message.stamp.flags == 0
        assert np.hypot(one.center_x_um * 1e-3 - PLACE_MM[0], one.center_y_um * 1e-3 - PLACE_MM[1]) < 2.0
        angle = one.center_x_um / BOARD.skin.radius_um
        pressed = np.array(one.skin.normal_force_un) * 1e-6
        assert pressed @ [np.cos(angle), np.sin(angle), 0] == pytest.approx(one.force_z_un * 1e-6, rel=0.01)
        forces.append(-one.force_z_un * 1e-6)
    assert forces == sorted(forces)
    assert 2 < forces[-1] < 20
    assert contacts[-1].stamp.flags & DARK
    assert wrenches[-2].validity[2] == VALID
    assert wrenches[-1].validity[2] == INVALID
    assert status is not None
    assert status.skin_light_1e3 == pytest.approx(1000 * AGED, abs=20)
    assert "HEALTH_SKIN_AGED" in host.schema.enum_names("HealthBit", status.health)
