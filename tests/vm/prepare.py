"""What the virtual board runs on, into FOLDER: a board, cameras of libcamera's virtual pipeline, a calibration.

    python3 tests/vm/prepare.py FOLDER

The pictures are those of tests/e2e/tiny_sensor.py, drawn: the virtual
board proves the way of the bytes, not the forces.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "e2e"))
from tiny_sensor import draw, make_calibration, write_board  # noqa: E402

from ruffini.boards import find_board  # noqa: E402

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
# The pipeline shows each picture four times; whatever repeats has no valid force.
N_REST, N_PRESSED, DEPTH = 12, 6, 0.25
CAMERA = """"{name}":
  supported_formats:
  - width: {width}
    height: {height}
  frames:
    path: "/vm/{name}/"
  location: "CameraLocationFront"
  model: "drawn dots"
"""


def main() -> None:
    out = Path(sys.argv[1])
    for name, hardware in BOARDS.items():
        changes = {'name = "tiny"': f'name = "{name}"', "rate_mhz = 60000": "rate_mhz = 10000"}
        path = write_board(out / name, changes) / "board.toml"
        path.write_text(path.read_text().split("[temperature]")[0] + hardware)
    board = find_board(out / "vmpad")
    cameras = (CAMERAS / "virtual.yaml").read_text().replace("/src/tests/data/cameras", "/vm")
    (out / "stripes.jpg").write_bytes((CAMERAS / "stripes.jpg").read_bytes())
    half = board.camera.width_px // 2
    columns = {
        "VirtualDots": slice(None),
        "VirtualPress": slice(None),
        "PadLeft": slice(half),
        "PadRight": slice(half, None),
    }
    for name, part in columns.items():
        (out / name).mkdir()
        for k in range(N_REST + (N_PRESSED if name == "VirtualPress" else 0)):
            picture = draw(board, DEPTH if k >= N_REST else 0.0, k)[:, part]
            cv2.imwrite(str(out / name / f"{k}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 98])
        cameras += CAMERA.format(name=name, width=picture.shape[1], height=picture.shape[0])
    (out / "virtual.yaml").write_text(cameras)
    (out / "calibration.safetensors").write_bytes(make_calibration(board).data)


if __name__ == "__main__":
    main()
