"""Every fitting verb judges what it made: implausible marks, copies, units; the verdict travels with the file."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal_in, run_ruffini
from test_photometric import BALL_MM, PX_PER_MM, draw

from ruffini.boards import find_board
from ruffini.calibrate import container
from ruffini.calibrate.gates import Gate, gates_in, of_stage, verdict
from ruffini.calibrate.log.touches import TouchLog
from ruffini.errors import InputError
from ruffini.estimators.material.judge import gates_of_modulus
from ruffini.estimators.operator.fit import Material
from ruffini.estimators.operator.judge import Judged, gates_of_forces
from ruffini.estimators.photometric.presses import load_presses

COLUMNS = "image,center_x_px,center_y_px,contact_radius_px"
N = 9
Circle = tuple[float, float, float]


def write(folder: Path, circles: list[Circle], marked: list[Circle] | None = None, seed: int = 3) -> Path:
    """Presses at `circles`; the table says `marked`."""
    rng = np.random.default_rng(seed)
    folder.mkdir(exist_ok=True)
    cv2.imwrite(str(folder / "reference.png"), draw(rng, None))
    lines = [COLUMNS]
    for i, (circle, said) in enumerate(zip(circles, marked or circles, strict=True)):
        cv2.imwrite(str(folder / f"{i}.png"), draw(rng, circle))
        lines.append(f"{i}.png," + ",".join(f"{v:.6g}" for v in said))
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "presses.toml").write_text(f"ball_mm = {BALL_MM}\npx_per_mm = {PX_PER_MM}\n")
    return folder


def good(seed: int = 3) -> list[Circle]:
    rng = np.random.default_rng(seed)
    return [(rng.uniform(45, 115), rng.uniform(40, 80), rng.uniform(12, 18)) for _ in range(N)]


def fit(folder: Path, out: Path) -> tuple[int, str]:
    done = run_ruffini("cal", "fit", "--only", "photometric", folder, "--board", "gelslim", "--foreign", "--out", out)
    return done.code, done.err


def gates_of(path: Path) -> str | None:
    return container.read(path).metadata.get("gates")


def test_good_presses_pass_and_say_so(tmp_path: Path) -> None:
    code, err = fit(write(tmp_path / "balls", good()), tmp_path / "a.safetensors")
    assert code == 0, err
    assert gates_of(tmp_path / "a.safetensors") == "passed"
    gates = gates_in(container.read(tmp_path / "a.safetensors"))
    assert gates is not None
    assert {g.name for g in gates} == {"places", "normals"}


def test_a_circle_beyond_the_ball_is_skipped(tmp_path: Path) -> None:
    marked = good()
    marked[4] = (*marked[4][:2], 1e9)
    marked[7] = (*marked[7][:2], 1.2 * BALL_MM / 2 * PX_PER_MM)
    presses = load_presses(write(tmp_path / "balls", good(), marked))
    assert [s.path.name for s in presses.skipped] == ["4.png", "7.png"]
    assert "its circle has a radius of 1e+09 px, the ball only 37.5 px" in presses.skipped[0].reason


def test_every_circle_beyond_the_ball_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path / "balls", good(), [(x, y, 1e9) for x, y, _ in good()])
    with pytest.raises(InputError, match="give --ball-mm as the diameter"):
        load_presses(folder)


def test_diameters_in_place_of_radii_fail_the_gate(tmp_path: Path) -> None:
    folder = write(tmp_path / "balls", good(), [(x, y, 2 * r) for x, y, r in good()])
    code, err = fit(folder, tmp_path / "a.safetensors")
    assert code == 1, err
    assert "FAIL normals" in err
    assert gates_of(tmp_path / "a.safetensors") == "failed: normals"
    done = run_ruffini("cal", "flash", tmp_path / "a.safetensors")
    assert done.code == 4
    assert "fails its gates" in refusal_in(done.err)


def test_copies_of_one_press_are_one_press(tmp_path: Path) -> None:
    folder = write(tmp_path / "balls", good()[:1])
    lines = [COLUMNS]
    for i in range(40):
        shutil.copy(folder / "0.png", folder / f"copy{i}.png")
        lines.append(f"copy{i}.png,80,60,15")
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"lists 1 usable presses: .*the same picture as copy0\.png"):
        load_presses(folder)


def test_one_place_pressed_often_fails_the_gate(tmp_path: Path) -> None:
    code, err = fit(write(tmp_path / "balls", [(80.0, 60.0, 15.0)] * N), tmp_path / "a.safetensors")
    assert code == 1
    assert "FAIL places: 1 different places or depths, at least 3" in err
    assert gates_of(tmp_path / "a.safetensors") == "failed: places"


@pytest.mark.parametrize(
    ("factor", "hint"), [(1 / 4.448, "is the reference in lbf"), (3.0, "is its unit N"), (0.8, None)]
)
def test_a_modulus_far_from_the_boards_names_the_unit(factor: float, hint: str | None) -> None:
    board = find_board("gelslim")
    slab_pa, thickness_m = board.pad.modulus_pa, board.pad.thickness_um * 1e-6
    (gate,) = gates_of_modulus(Material(factor * slab_pa, 0.48, thickness_m), board)
    assert gate.ok == (hint is None)
    assert verdict([gate]) == ("passed" if hint is None else "failed: modulus")
    if hint is not None:
        assert hint in gate.text


def test_a_merged_file_is_as_good_as_its_worst_part(tmp_path: Path) -> None:
    base = container.base_metadata(find_board("gelslim"))
    row = '{"gates": [{"name": "%s", "ok": %s, "value": 1.0, "limit": 1.0, "text": ""}]}'

    def part(kind: str, gates: str | None, ok: str = "true") -> container.CalibrationFile:
        said = {} if gates is None else {"gates": gates, "residuals": row % (kind, ok)}
        return container.pack({f"{kind}.x": np.zeros(2, np.int16)}, {**base, **said})

    colours, wrench = part("photometric", "passed"), part("wrench", "passed")
    bad, none = part("dark", "failed: dark", "false"), part("rest", None)
    for files, verdict_of_all, names in (
        ([colours, wrench], "passed", ["photometric", "wrench"]),
        ([bad, colours], "failed: dark", ["dark", "photometric"]),
        ([none, colours], None, ["photometric"]),
        ([colours, none], None, ["photometric"]),
        ([none], None, None),
    ):
        merged = container.merge(files)
        assert merged.metadata.get("gates") == verdict_of_all
        gates = gates_in(merged)
        assert (None if gates is None else [g.name for g in gates]) == names


def test_a_stage_that_is_fitted_again_is_judged_by_its_last_fit() -> None:
    base = container.base_metadata(find_board("gelslim"))

    def fitted(kind: str, **axes: bool) -> container.CalibrationFile:
        gates = of_stage(kind, [Gate(name, ok, 1.0, 1.0, "") for name, ok in axes.items()])
        said = {"residuals": json.dumps({"gates": [gate._asdict() for gate in gates]}), "gates": verdict(gates)}
        return container.pack({f"{kind}.x": np.zeros(2, np.int16)}, {**base, **said})

    old = container.merge([fitted("photometric", normals=False), fitted("wrench", Fx=False, Tz=False)])
    assert old.metadata["gates"] == "failed: normals, Fx, Tz"
    again = container.merge([old, fitted("wrench", Fx=True)])
    assert again.metadata["gates"] == "failed: normals"
    assert [(g.name, g.ok) for g in gates_in(again) or []] == [("normals", False), ("Fx", True)]
    good = container.merge([again, fitted("photometric", normals=True)])
    assert good.metadata["gates"] == "passed"
    assert container.merge([good, fitted("wrench", Fx=False)]).metadata["gates"] == "failed: Fx"


@pytest.mark.parametrize(
    ("name", "rest_n", "is_ok"),
    [
        ("gelslim", (0.001, 0.001, 0.03), False),
        ("gelsight-mini", (0.001, 0.001, 0.03), True),  # it states that it measures no normal force
        ("gelsight-mini", (0.03, 0.001, 0.001), False),
    ],
)
def test_rest_is_judged_along_the_axes_that_a_board_measures(
    name: str, rest_n: tuple[float, float, float], *, is_ok: bool
) -> None:
    held, pressed = np.zeros((1, 1, 3)), np.array([[0.0, 0.0, -1.0, 0.0, 0.0, 0.0]])
    log = TouchLog(held, pressed, np.zeros(1, np.int64), held, pressed)
    gates = gates_of_forces(find_board(name), log, Judged(pressed, np.array([rest_n])), None)
    (rest,) = [gate for gate in gates if gate.name == "rest"]
    assert rest.ok is is_ok
    assert ("untouched frames along x and y" in rest.text) is (name == "gelsight-mini")
