"""A board for pictures that no board of ours took: their size and scale, and no pad to speak of."""

from __future__ import annotations

from collections.abc import Sequence

from ruffini.boards import Board, parse_board

TEXT = """schema = 1
[board]
name = "{name}"
product = "pictures without a board"
not_measured = []
[camera]
optics = "recorded"
width_px = {width}
height_px = {height}
rate_mhz = 30000
focal_mpx = {focal}
center_x_mpx = {center_x}
center_y_mpx = {center_y}
standoff_um = {standoff}
[pad]
size_x_um = {size_x}
size_y_um = {size_y}
thickness_um = {thickness}
modulus_pa = 200000
poisson_1e4 = 4800
[grid]
n_x = 9
n_y = 9
n_layers = 2
[window]
min_x_um = 0
min_y_um = 0
max_x_um = {size_x}
max_y_um = {size_y}
{markers}[depth]
gauge = "mean"
margin_um = 0
step_px = {step}
[contact]
threshold_un = 1000
min_nodes = 1
[field]
force_lsb_un = 10
[pipeline]
n_rest_frames = 1
stages = [{stages}]
"""


def picture_board(
    shape: tuple[int, ...],
    px_per_mm: float,
    stages: Sequence[str],
    *,
    name: str = "pictures",
    standoff_mm: float,
    margin_mm: float = 0.0,
    thickness_um: int = 4000,
    step_px: int = 1,
    markers: str = "",
) -> Board:
    """A pinhole `standoff_mm` above the middle of a pad that ends `margin_mm` beyond the picture.

    `shape` is the picture's (height, width, ...), `markers` the text of a table [markers] where a stage needs one.
    """
    height, width = shape[:2]
    size_x, size_y = (round((n / px_per_mm + 2 * margin_mm) * 1e3) for n in (width, height))
    text = TEXT.format(
        name=name, width=width, height=height, focal=round(px_per_mm * standoff_mm * 1e3),
        center_x=width * 500 - 500, center_y=height * 500 - 500, standoff=round(standoff_mm * 1e3),
        size_x=size_x, size_y=size_y, thickness=thickness_um, step=step_px, markers=markers,
        stages=", ".join(f'"{stage}"' for stage in stages),
    )  # fmt: skip
    return parse_board(text, f"the board of {name}")
