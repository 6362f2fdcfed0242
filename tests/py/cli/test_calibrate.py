"""cal operator and photometric as typed: what they make, and what they refuse before they make it."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal_in
from small_board import Files, Run

from ruffini.calibrate import container

BALL_MM, PX_PER_MM = 4.0, 15.0  # base.toml: 300 px over 20 mm


def press(rng: np.random.Generator, size: tuple[int, int], circle: tuple[float, float, float] | None) -> np.ndarray:
    """A ball's cap in light that grows with the normal's x in blue and with its y in red."""
    y, x = np.mgrid[: size[0], : size[1]].astype(float)
    normal = np.zeros((*size, 3))
    if circle is not None:
        dx, dy = x - circle[0], y - circle[1]
        inside = np.hypot(dx, dy) < circle[2]
        normal[inside, 0] = dx[inside] / (BALL_MM / 2 * PX_PER_MM)
        normal[inside, 2] = dy[inside] / (BALL_MM / 2 * PX_PER_MM)
    return np.clip(np.round(110 * (1 + 0.5 * normal) + rng.normal(0, 1, normal.shape)), 0, 255).astype(np.uint8)


def write_presses(folder: Path, size: tuple[int, int] = (240, 320)) -> Path:
    rng = np.random.default_rng(11)
    folder.mkdir()
    cv2.imwrite(str(folder / "reference.png"), press(rng, size, None))
    lines = ["image,center_x_px,center_y_px,contact_radius_px"]
    for i in range(4):
        circle = (rng.uniform(40, size[1] - 40), rng.uniform(40, size[0] - 40), rng.uniform(9, 12))
        cv2.imwrite(str(folder / f"{i}.png"), press(rng, size, circle))
        lines.append(f"{i}.png,{circle[0]:.2f},{circle[1]:.2f},{circle[2]:.2f}")
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    return folder


def test_photometric_makes_a_table_that_the_core_takes(files: Files, run: Run, tmp_path: Path) -> None:
    folder, out = write_presses(tmp_path / "presses"), tmp_path / "colours.safetensors"
    code, text, err = run(
        "cal", "fit", "--only", "photometric", folder, "--board", files.folder, "--out", out, "--json"
    )
    assert code == 0, err
    report = json.loads(text)
    assert report["n_presses"] == 4
    assert report["held_out_normal_median_deg"] < 3
    file = container.read(out)
    assert file.kinds == ["photometric"]
    assert file.metadata["optics"] == files.board.camera.optics
    assert json.loads(file.metadata["residuals"])["stages"]["photometric"]["n_presses"] == 4
    assert run("cal", "file", "verify", out, "--board", files.folder)[0] == 0


def test_presses_of_other_optics_need_to_be_called_so(files: Files, run: Run, tmp_path: Path) -> None:
    folder, out = write_presses(tmp_path / "presses", (200, 220)), tmp_path / "colours.safetensors"
    code, _, err = run("cal", "fit", "--only", "photometric", folder, "--board", files.folder, "--out", out)
    assert code == 2
    assert "220x200" in err
    assert "--foreign" in err
    assert not out.exists()
    assert (
        run("cal", "fit", "--only", "photometric", folder, "--board", files.folder, "--out", out, "--foreign")[0] == 0
    )
    assert container.read(out).metadata["optics"] == "foreign"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--method", "magic"), "magic"),
        (("--noise-um", "5,5"), "5,5"),
        (("--noise-um", "5,5,0"), "5,5,0"),
        (("--noise-um", "5,5,nan"), "nan"),
        (("--method", "ridge", "--weight", "-1"), "-1"),
        (("--method", "ridge", "--weight", "nan"), "nan"),
        (("--method", "ridge", "--weight", "best"), "lcurve, cv"),
        (("--weight", "cv"), "of --method ridge"),
        (("--method", "optimal", "--gauge-um", "-1"), "-1"),
        (("--method", "optimal", "--tilt-um", "nan"), "nan"),
        (("--material", "nothing.json"), "nothing.json"),
    ],
    ids=lambda v: " ".join(v) if isinstance(v, tuple) else "",
)
def test_operator_refuses(words: tuple[str, ...], said: str, files: Files, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "o.safetensors"
    code, text, err = run("cal", "fit", "--only", "operator", "--board", files.folder, "--out", out, *words)
    assert (code, text) == (2, ""), err
    assert said in refusal_in(err)
    assert not out.exists()


def test_merge_of_a_file_with_itself_and_of_two_boards(files: Files, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "m.safetensors"
    code, text, _ = run("cal", "file", "merge", files.operator, files.calibration, "--out", out, "--json")
    assert (code, json.loads(text)["kinds"]) == (0, ["operator", "photometric"])
    file = container.read(files.operator)
    other = tmp_path / "other.safetensors"
    container.write(other, container.pack(file.tensors, {**file.metadata, "board": "another"}))
    before = out.read_bytes()
    code, _, err = run("cal", "file", "merge", out, other, "--out", out)
    assert code == 4
    assert "another" in err
    assert out.read_bytes() == before


def test_verify_tells_a_changed_file_from_one_for_another_board(files: Files, run: Run, tmp_path: Path) -> None:
    data = bytearray(files.operator.read_bytes())
    data[-100] ^= 1
    changed = tmp_path / "changed.safetensors"
    changed.write_bytes(data)
    assert run("cal", "file", "verify", changed)[0] == 5
    assert run("cal", "file", "verify", files.operator, "--board", "gelslim")[0] == 4
    assert run("cal", "file", "verify", tmp_path / "none.safetensors")[0] == 2
    assert run("cal", "file", "verify", files.operator, "--board", files.folder)[0] == 0


def test_a_path_that_no_verb_can_use_is_named(run: Run) -> None:
    code, _, err = run("board", "check", "x" * 5000)
    assert code == 2
    assert "File name too long" in refusal_in(err)


def test_ridge_weight_by_rule(files: Files, run: Run, tmp_path: Path) -> None:
    out, plot = tmp_path / "o.safetensors", tmp_path / "plot.png"
    words = (
        "cal",
        "fit",
        "--only",
        "operator",
        "--board",
        files.folder,
        "--out",
        out,
        "--method",
        "ridge",
        "--plot",
        plot,
        "--json",
    )
    code, text, err = run(*words, "--weight", "cv")
    assert code == 0, err
    result = json.loads(text)
    assert 0 <= result["weight"] < 1
    assert result["force_error"] > 0
    assert result["force_error_raw"] > 0
    assert container.read(out).metadata["operator.method"] == "ridge"
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_rule_that_finds_no_weight_writes_nothing(files: Files, run: Run, tmp_path: Path) -> None:
    """This board's mesh is too coarse for an L-curve with a corner."""
    out = tmp_path / "o.safetensors"
    code, text, err = run("cal", "fit", "--only", "operator", "--board", files.folder, "--out", out,
        "--method", "ridge",
                          "--weight", "lcurve")  # fmt: skip
    assert (code, text) == (2, "")
    assert "lcurve finds no ridge weight" in err
    assert not out.exists()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("poisson_1e4 = 4800", "poisson_1e4 = 5000", "pad.poisson_1e4"),
        ("n_x = 11", "n_x = 1", "grid.n_x"),
        ("n_layers = 3", "n_layers = 1", "grid.n_layers"),
        ("max_x_um = 20000", "max_x_um = 1000", "window"),
    ],
)
def test_operator_of_a_pad_that_cannot_be(
    old: str, new: str, said: str, files: Files, run: Run, tmp_path: Path
) -> None:
    text = (files.folder / "board.toml").read_text()
    assert old in text
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "board.toml").write_text(text.replace(old, new))
    out = tmp_path / "o.safetensors"
    code, text, err = run("cal", "fit", "--only", "operator", "--board", tmp_path / "small", "--out", out)
    assert (code, text) == (2, ""), err
    assert said in refusal_in(err)
    assert [p.name for p in tmp_path.iterdir()] == ["small"]


def test_operator_of_a_material_that_cannot_be(files: Files, run: Run, tmp_path: Path) -> None:
    material, out = tmp_path / "m.json", tmp_path / "o.safetensors"
    material.write_text(json.dumps({"board": "small", "modulus_pa": 2e5, "poisson": 0.5, "thickness_m": 4e-3}))
    code, text, err = run(
        "cal", "fit", "--only", "operator", "--board", files.folder, "--out", out, "--material", material
    )
    assert (code, text) == (2, "")
    assert refusal_in(err).startswith(f"ruffini: {material}: poisson 0.5 is no pad of board 'small'")
    assert not out.exists()


def test_operator_of_a_board_whose_depth_is_its_markers(files: Files, run: Run, tmp_path: Path) -> None:
    text = (files.folder / "board.toml").read_text()
    text = text[: text.index("stages = ")] + 'stages = ["difference", "markers", "displacement", "operator"]\n'
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "board.toml").write_text(text.replace("[depth]\n", '[depth]\nsource = "markers"\n'))
    out = tmp_path / "o.safetensors"
    words = (
        "cal",
        "fit",
        "--only",
        "operator",
        "--board",
        tmp_path / "small",
        "--out",
        out,
        "--method",
        "optimal",
        "--json",
    )
    code, _, err = run(*words, "--gauge-um", "3")
    assert code == 2
    assert "--gauge-um" in err
    assert not out.exists()
    code, text, err = run(*words)
    assert code == 0, err
    said, file = json.loads(text), container.read(out)
    assert file.kinds == ["marker_depth", "operator"]
    off_um, pressed_um = said["depth_of_markers_um"]
    assert 0.1 * pressed_um < off_um < pressed_um
    assert int(file.metadata["marker_depth.gauge_um"]) == pytest.approx(said["gauge_um"], abs=1)
