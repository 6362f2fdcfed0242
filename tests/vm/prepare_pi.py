"""What ruffinid on the emulated Raspberry Pi is started with, into FOLDER: the board of boards/README.md, a recording.

python3 tests/vm/prepare_pi.py FOLDER
"""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DATA = ROOT / "tests" / "data"


def main() -> None:
    out = Path(sys.argv[1])
    wiring = (ROOT / "boards" / "README.md").read_text().split("## Wiring one")[1]
    (toml,) = re.findall(r"^```toml\n(.*?)```", wiring.split("\n## ")[0], re.M | re.S)
    board = (DATA / "boards" / "base.toml").read_text().replace('name = "sample"', 'name = "pipad"')
    (out / "pipad").mkdir()
    (out / "pipad" / "board.toml").write_text(f"{board}\n{toml}")
    (out / "frames").mkdir()
    (out / "frames" / "recording.toml").write_text('board = "pipad"\n')
    for k in range(4):
        shutil.copy(DATA / "cameras" / "stripes.jpg", out / "frames" / f"{k}.jpg")


if __name__ == "__main__":
    main()
