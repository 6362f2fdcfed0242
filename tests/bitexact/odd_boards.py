"""Boards of the bit-exact tests, as text."""

from __future__ import annotations

from pathlib import Path

BOARDS = Path(__file__).parents[2] / "boards"

# A small board of awkward sizes: odd lattice, 3 x odd depth grid, window inside the pad, markers that
# do not fill the view. `{...}` are filled by each test.
SMALL = """
schema = 1
[board]
name = "small"
product = "test"
not_measured = []
[camera]
optics = "test"
width_px = {width}
height_px = {height}
rate_mhz = 60000
focal_mpx = 101300
center_x_mpx = 33210
center_y_mpx = 20777
standoff_um = 6123
[pad]
size_x_um = 4001
size_y_um = 3003
thickness_um = 2000
modulus_pa = 200000
poisson_1e4 = 4800
[grid]
n_x = 9
n_y = 7
n_layers = 3
[window]
min_x_um = 300
min_y_um = 0
max_x_um = 3801
max_y_um = 2600
[markers]
polarity = "{polarity}"
n_x = 5
n_y = 3
pitch_x_um = 733
pitch_y_um = 751
first_x_um = 501
first_y_um = 633
diameter_um = 301
threshold_1e3 = 137
max_lost = 3
[depth]
gauge = "{gauge}"
margin_um = 411
step_px = {step}
[contact]
threshold_un = 3000
min_nodes = 4
[field]
force_lsb_un = 10
[pipeline]
n_rest_frames = 3
stages = ["difference", "markers", "photometric", "poisson", "displacement"]
"""


def small_board(
    *, width: int = 66, height: int = 42, step: int = 2, gauge: str = "margin", polarity: str = "dark"
) -> str:
    return SMALL.format(width=width, height=height, step=step, gauge=gauge, polarity=polarity)


def board_text(name: str) -> str:
    return (BOARDS / name / "board.toml").read_text()
