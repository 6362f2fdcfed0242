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
CHANGES = {'name = "tiny"': 'name = "vmpad"', "rate_mhz = 60000": "rate_mhz = 10000"}
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
    folder = write_board(out / "vmpad", CHANGES)
    path = folder / "board.toml"
    # The virtual board has no thermometer.
    path.write_text(path.read_text().split("[temperature]")[0] + HARDWARE)
    board = find_board(folder)
    cameras = (CAMERAS / "virtual.yaml").read_text().replace("/src/tests/data/cameras", "/vm")
    (out / "stripes.jpg").write_bytes((CAMERAS / "stripes.jpg").read_bytes())
    for name, n_pressed in (("VirtualDots", 0), ("VirtualPress", N_PRESSED)):
        (out / name).mkdir()
        for k in range(N_REST + n_pressed):
            picture = draw(board, DEPTH if k >= N_REST else 0.0, k)
            cv2.imwrite(str(out / name / f"{k}.jpg"), picture, [cv2.IMWRITE_JPEG_QUALITY, 98])
        cameras += CAMERA.format(name=name, width=board.camera.width_px, height=board.camera.height_px)
    (out / "virtual.yaml").write_text(cameras)
    (out / "calibration.safetensors").write_bytes(make_calibration(board).data)


if __name__ == "__main__":
    main()
