"""What the virtual board runs on, into FOLDER: a board, cameras of the virtual pipeline, a calibration, the truth.

    python3 tests/vm/prepare.py FOLDER

The pictures and the calibration are those of the tiny twin (tests/e2e/tiny_twin.py). SIMULATED.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests" / folder) for folder in ("e2e", "support")]
from tiny_sensor import Sensor, make_calibration, write_board  # noqa: E402
from tiny_twin import CHANGES, make_twin  # noqa: E402

from ruffini.boards import find_board  # noqa: E402
from ruffini.sim.contact import Indenter, Pose  # noqa: E402
from ruffini.sim.programs import Rest, Step, Touch  # noqa: E402
from ruffini.sim.scenario import Scenario  # noqa: E402
from ruffini.sim.story import play  # noqa: E402
from ruffini.sim.unit import TwinUnit  # noqa: E402

CAMERAS = ROOT / "tests" / "data" / "cameras"
HARDWARE = """
[light]
chip = "gpiochip0"
line = "LAMPS"

[reflex]
chip = "gpiochip0"
line = "TOUCH"
force_un = 100000
slip = "none"
when_invalid = "hold"

[eeprom]
bus = "/dev/i2c-0"
gel_address = 0x51
address_bytes = 2
"""
# A board that asks for more, and one that asks for nothing: the second pad of a computer whose lines the first has.
# This camera makes frames as fast as they are taken: the other CPU is for the rest.
FULL = (
    HARDWARE
    + """
[temperature]
place = "gel"
path = "/sys/class/hwmon/hwmon0/temp1_input"

[led_driver]
bus = "/dev/i2c-0"
address = 0x15
resistor_ohm = 1000
currents_ua = [22500, 0, 4500]
ramp_ms = 64

[threads]
frame_priority = 46
frame_cpus = [1]
capture_priority = 45
capture_cpus = [1]
link_priority = 30
"""
)
STEREO = """
[stereo]
tolerance_us = 50000
"""
EXPOSURE = """
[exposure]
time_us = 5000
gain_1e3 = 1000
red_1e3 = 1000
blue_1e3 = 1000
"""
OF_USB = """
[exposure]
time_us = 5000
gain_1e3 = 1500
white_kelvin = 5000
"""
BOARDS = {"vmpad": HARDWARE, "vmfull": FULL, "vmbare": "", "vmstereo": STEREO, "vmexposed": EXPOSURE, "vmusb": OF_USB}
# What that camera has not.
BOARDS |= {
    "vmdazzled": OF_USB.replace("gain_1e3 = 1500", "gain_1e3 = 8000"),
    "vmblue": OF_USB.replace("white_kelvin = 5000", "white_kelvin = 9000"),
}
N_REST = 12  # pictures before the first touch: the board learns its rest image on 8
# A picture that is like one of the last 31 counts as an old one, so the loops are longer, with room for frames that a
# slow computer skips: of an untouched pad, and of the story told several times with other noise.
N_STILL, N_TELLINGS = 120, 4
CAMERA = """"{name}":
  supported_formats:
  - width: {width}
    height: {height}
  frames:
    path: "/vm/{name}/"
  location: "CameraLocationFront"
  model: "the tiny twin"
"""
Picture = npt.NDArray[np.uint8]  # (height, width, 3)
MM = 1e-3


def told(indenter: Indenter, *ways: tuple[float, float, float, int]) -> Touch:
    """From place to place: x, y, depth in mm and in how many pictures; the first is where it begins, above the pad."""
    poses, pose = [], Pose(ways[0][0] * MM, ways[0][1] * MM, 0.0)
    for x, y, depth, n in ways:
        target = Pose(x * MM, y * MM, depth * MM)
        poses += [pose.towards(target, i / n) for i in range(1, n + 1)]
        pose = target
    return Touch(indenter, poses, [True] * len(poses))


# A ball pressed and sheared, a flat punch pressed and sheared; their forces are 0.07 to 1.26 N. Then from the start.
STORY: list[Step] = [
    Rest(N_REST),
    told(Indenter("sphere", 3 * MM), (1, 0.5, 0.8, 4), (1, 0.5, 0.8, 2), (1.3, 0.5, 0.8, 3), (1.3, 0.5, 0, 2)),
    Rest(3),
    told(Indenter("flat", 2 * MM), (-3, -2, 0.6, 4), (-3.1, -1.8, 0.6, 3), (-3.1, -1.8, 0, 2)),
    Rest(3),
]


def limited_709(bgr: Picture) -> Picture:
    """Y'CbCr of limited range by ITU-R BT.709, which is what libcamera's virtual pipeline says that its frames are."""
    b, g, r = np.moveaxis(bgr.astype(float), 2, 0)
    y = 0.2126 * r + 0.7152 * g + 0.0722 * b
    planes = 16 + y * 219 / 255, 128 + (b - y) / 1.8556 * 224 / 255, 128 + (r - y) / 1.5748 * 224 / 255
    return np.rint(np.stack(planes, axis=2)).astype(np.uint8)


def write_jpeg(path: Path, bgr: Picture) -> None:
    """A file whose components come out of that pipeline as its frame: NV12 has their U and V of 2x2 pixels.

    A JPEG's components are full-range BT.601 by its own rule; the pipeline hands them on as they are.
    """
    Image.fromarray(limited_709(bgr), "YCbCr").save(path, "JPEG", quality=100, subsampling=2)


def play_story(unit: TwinUnit, story: list[Step]) -> tuple[list[Picture], npt.NDArray[np.float64]]:
    """The story's pictures and, of each, the true wrench, (n, 6), N and N m."""
    scenario, renderer = Scenario(seed=3), unit.renderer()
    pictures, wrenches, before = [], [], None
    for k, moment in enumerate(play(unit, story)):
        now = moment.displacement.copy()
        pictures.append(scenario.picture(renderer, k, now, before))
        wrenches.append(moment.wrench())
        before = now
    return pictures, np.array(wrenches)


def main() -> None:
    out = Path(sys.argv[1])
    for name, hardware in BOARDS.items():
        changes = {**CHANGES, 'name = "tiny"': f'name = "{name}"', "rate_mhz = 60000": "rate_mhz = 10000"}
        path = write_board(out / name, changes) / "board.toml"
        path.write_text(path.read_text().split("[temperature]")[0] + hardware)
    board = find_board(out / "vmpad")
    with tempfile.TemporaryDirectory() as folder:
        twin = make_twin(Sensor(board, out / "vmpad", out, make_calibration(board).data), Path(folder))
    pictures, wrenches = play_story(twin.unit, STORY * N_TELLINGS)
    still, _ = play_story(twin.unit, [Rest(N_STILL)])
    (out / "calibration.safetensors").write_bytes(twin.calibration)
    np.savez(out / "truth.npz", pictures=np.array(pictures), wrench=wrenches, n_told=len(pictures) // N_TELLINGS)
    cameras = (CAMERAS / "virtual.yaml").read_text().replace("/src/tests/data/cameras", "/vm")
    (out / "stripes.jpg").write_bytes((CAMERAS / "stripes.jpg").read_bytes())
    half = board.camera.width_px // 2
    columns = {
        "VirtualRest": slice(None),
        "VirtualPress": slice(None),
        "PadLeft": slice(half),
        "PadRight": slice(half, None),
    }
    for name, part in columns.items():
        (out / name).mkdir()
        for k, picture in enumerate(pictures if name == "VirtualPress" else still):
            write_jpeg(out / name / f"{k}.jpg", picture[:, part])
        cameras += CAMERA.format(name=name, width=len(picture[0, part]), height=len(picture))
    (out / "virtual.yaml").write_text(cameras)


if __name__ == "__main__":
    main()
