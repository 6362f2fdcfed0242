"""Every experiment's figures stand in its board's wanted.toml, with the numbers where they belong."""

from __future__ import annotations

from typing import Any

import pytest
from papers.contact_glitter.experiment import figures as glitter
from papers.eltac.experiment import figures as skin
from papers.experiments import Figure
from papers.ftouch.experiment import figures as tray
from papers.gelslim.experiment import figures as pad
from papers.stereo_fingertip.experiment import headline as tip
from papers.stereo_fingertip.text import QUANTITIES, TESTS
from papers.wanted import load_wanted

from ruffini.boards import find_board
from ruffini.estimators.wrench.model import AXES

COVERED = {"within_1": 70.0, "within_2": 97.0, "mean_sigma": 0.1, "n": 9}


def of_tray() -> dict[str, Figure]:
    one = {
        "ours": [1.0, 2.0, 3.0, 4.0, 5.0, None],
        "paper": [7.0] * 6,
        "within_1_sigma": [0.7] * 6,
        "within_2_sigma": [0.95] * 6,
        "unflagged_wrong": 3,
    }
    return tray({
        "sets": {name: one for name in ("paper", "whole", "off_centre", "pen")}, "false_flags": 2,
        "published": {axis: 9.0 for axis in AXES},
    })  # fmt: skip


APART = {"20 mm, across": 0.99, "20 mm, along": 0.97, "20 mm, round": 1.0}


def of_skin() -> dict[str, Figure]:
    place = {"ours": 1.0, "method": 2.0, "paper": 3.0}
    force = {"ours": 4.0, "method": 5.0, "paper": 6.0}
    averages = ("ten frames", "five frames", "three frames", "one frame")
    edge = {f"edge points, {n}": {"ours": 8.0} for n in averages}
    loop = {"split_ours": 1.0, "split_quadratic": 25.0, "paper": 28.0}
    return skin({
        "places": {**{str(i): place for i in range(1, 6)}, "other places": {"n": 3, "ours": 1.5}},
        "forces": {f"points 3 to 9, {n}": force for n in averages} | edge,
        "both_ways": {"points 3 to 9": {"down": 1.0, "up": 2.0}, "edge points": {"down": 10.7, "up": 11.3}},
        "loops": {speed: loop for speed in ("0.1", "0.5", "1", "2", "4")},
        "trials": {"brightness": 0.3, "ours": 0.2},
        "two_fingers": {"15 mm, across": 0.91, "15 mm, along": 0.64, "15 mm, round": 0.33, **APART},
        "unflagged": {"wrong": 2}, "stated": {"force": COVERED, "place": COVERED},
    })  # fmt: skip


def of_glitter() -> dict[str, Figure]:
    shapes = ("triangle", "circle", "square", "hemisphere")
    row = {
        "fn": 0.2,
        "ft": 0.02,
        "moment": 0.001,
        "fn_method": 1.1,
        "fn_paper": 1.08,
        "ft_paper": 1.3,
        "moment_paper": 0.07,
    }
    bands = {band: {"rmse": 4.0, "n": 3.0} for band in ("20-40", "40-60", "60-80")}
    hardness = {"all": {"rmse": 4.4}, "kind_right": 1.0, "planar bands": bands, "Hertzian bands": bands}
    depth = {"gel": 0.072, "method": 0.383}
    result: dict[str, Any] = {
        "forces": {shape: row for shape in shapes},
        "by_bench": {"test, gel": 0.13, "repeat, gel": 0.3, "test, Shore A, told the kind": 4.7},
        "depth": {"paper's test": depth, "smallest, hardest triangle": {"gel": 0.05, "method": 0.163}},
        "hardness": {"paper's test": hardness}, "method_hardness_told": 7.8,
        "objects": [{"is_valid": True}] * 5 + [{"is_valid": False}] * 2, "failing": [{"is_valid": False}] * 3,
        "too_soft": [{"is_valid": True}], "unmarked": {"unmarked": 0.0},
        "stated": {name: COVERED for name in ("Fz", "Fz, sheared", "depth", "hardness")},
        "calibration": {"refused": {"h": {"sizes": 0.8, "shapes": 0.5}, "too soft": {"sizes": 0.44}}},
    }  # fmt: skip
    method = {f"{what}, {shape}": 0.24 for what in ("tangential force", "moment") for shape in shapes}
    return glitter(result, method)


def of_tip() -> dict[str, Figure]:
    row = {"n_frames": 3, "mean": {q: float(i) for i, q in enumerate(QUANTITIES)},
           "stated": {"force_n": COVERED}}  # fmt: skip
    area = {"whole": 8.8, "paper": 0.6, "n_whole": 4, "of_whole": 49}
    return tip({
        "paper_tests": {name: 0.5 for name in TESTS}, "published": {"force": 0.022, "X": 1.396},
        "stand_in": {"1": {q: 7.0 for q in QUANTITIES[:-1]}},
        "unseen": {name: row for name in ("any", "upright", "centred", "middle", "shapes")},
        "area": {tool: area for tool in ("flat", "square", "hexagon")},
    })  # fmt: skip


def of_pad() -> dict[str, Figure]:
    def row(state: str, part: str, tangential: float) -> dict[str, Any]:
        one = {"tangential": tangential, "normal": 0.1, "resultant": 0.01, "shear_over_normal": 0.07}
        return {"state": state, "part": part, "ours": one, "ridge": {name: 2 * value for name, value in one.items()}}

    shown = ("screw_m8", "screw_m6", "usb_plug", "shell", "steel_ball", "rigid_soft", "rigid_soft_held")
    states = [row("S1", "judge", 0.2), row("S2", "judge", 0.4), *(row(name, "show", 0.5) for name in shown)]
    soft = {"error": {"ours": 0.1, "ridge": 0.9}, "inner_over_outer": {"ours": 0.85, "ridge": 0.7}}
    return pad({"states": states, "cored": {"rigid_soft": soft, "rigid_soft_held": soft}})


FIGURES = {
    "ftouch": of_tray, "eltac": of_skin, "contact-glitter": of_glitter, "stereo-fingertip": of_tip, "gelslim": of_pad,
}  # fmt: skip


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_wanted_and_every_wanted_one_is_measured(name: str) -> None:
    made, wanted = set(FIGURES[name]()), {one.name for one in load_wanted(find_board(name))}
    assert made <= wanted
    missing = wanted - made
    if name == "ftouch":  # an axis that no frame tells has none
        missing = {n for n in missing if ", Tz" not in n}
    if name == "contact-glitter":  # shapes that the made-up log does not have
        missing = {n for n in missing if not n.startswith("refused at left-out sizes")}
    assert missing == set()


def test_numbers_stand_where_they_belong() -> None:
    made = {name: make() for name, make in FIGURES.items()}
    assert made["ftouch"]["off_centre, Tx"] == Figure(4.0, 7.0, 9.0)
    assert made["ftouch"]["paper, Fx within 2 sigma"].ours == pytest.approx(95)
    assert made["ftouch"]["whole, wrong without a flag"] == Figure(3)
    assert made["eltac"]["position, indenter 2"] == Figure(1.0, 2.0, 3.0)
    assert made["eltac"]["force, points 3 to 9, one frame"] == Figure(4.0, 5.0, 6.0)
    assert made["eltac"]["force at every level, edge points, up"] == Figure(11.3)
    assert made["eltac"]["two fingers at 15 mm, along"].ours == pytest.approx(64)
    assert made["contact-glitter"]["normal force, square"] == Figure(0.2, 1.1, 1.08)
    assert made["contact-glitter"]["moment, circle"] == Figure(0.001, 0.24, 0.07)
    assert made["contact-glitter"]["depth by bench knowledge, smallest, hardest triangle"] == Figure(0.3, 0.163, 0.2)
    assert made["contact-glitter"]["depth told the gel's surface, paper's test"] == Figure(0.072, 0.383, None)
    assert made["contact-glitter"]["objects of Fig. 9 measured"] == Figure(5)
    assert made["contact-glitter"]["H, T, nut and Shore A 5 refused"] == Figure(3)
    assert made["contact-glitter"]["refused at left-out sizes, h"].ours == pytest.approx(80)
    assert made["stereo-fingertip"]["the paper's test, X"] == Figure(0.5, None, 1.396)
    assert made["stereo-fingertip"]["any, z_mm"] == Figure(1.0, 7.0)
    assert made["stereo-fingertip"]["shapes, z_mm"] == Figure(1.0, None)
    assert made["stereo-fingertip"]["area reported where the whole face bears"].ours == pytest.approx(100 * 12 / 147)
    assert made["gelslim"]["ten states, tangential field"].ours == pytest.approx(0.3)
    assert made["gelslim"]["ten states, tangential field"].method == pytest.approx(0.6)
    assert made["gelslim"]["rigid_soft, inner over outer shear"] == Figure(0.85, 0.7)
