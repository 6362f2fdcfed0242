"""URDF frames of every board."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from ruffini.boards import board_names, find_board
from ruffini.ros.urdf import urdf

BOARDS = board_names()


@pytest.mark.parametrize("name", BOARDS)
def test_every_board_has_a_tree_of_frames(name: str) -> None:
    robot = ET.fromstring(urdf(find_board(name), "ruffini_1"))
    links = [link.get("name") for link in robot.iter("link")]
    children = {j.find("child").get("link"): j.find("parent").get("link") for j in robot.iter("joint")}  # type: ignore[union-attr]
    assert links[:2] == ["ruffini_1_base", "ruffini_1_pad"]
    assert set(links) - set(children) == {"ruffini_1_base"}, "one root"
    assert set(children.values()) <= set(links)


def test_the_camera_of_a_flat_pad_stands_behind_it() -> None:
    board = find_board(Path(__file__).parents[3] / "boards" / "gelslim")
    robot = ET.fromstring(urdf(board, "x"))
    (origin,) = [j.find("origin") for j in robot.iter("joint") if j.find("child").get("link").endswith("optical_frame")]  # type: ignore[union-attr]
    assert origin is not None
    assert origin.get("xyz") == "0 0 -0.02"
    assert robot.find(".//visual/geometry/box").get("size") == "0.02 0.016 0.004"  # type: ignore[union-attr]
