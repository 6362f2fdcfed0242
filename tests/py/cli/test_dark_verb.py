"""cal fit --only dark as typed, and in the core: daylight that leaks in no longer makes slopes smaller."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_board import Files, Run

from ruffini.calibrate import container
from ruffini.calibrate.fit.job import Job
from ruffini.core import Pipeline
from ruffini.errors import InputError
from ruffini.estimators.camera.stage import CAMERA
from ruffini.estimators.dark.frame import dark_frame, dark_of
from ruffini.estimators.dark.stage import DARK
from ruffini.estimators.photometric.fit import collect_samples
from ruffini.estimators.photometric.pad_view import pad_view
from ruffini.estimators.photometric.presses import load_presses
from ruffini.estimators.photometric.stage import PHOTOMETRIC
from ruffini.estimators.table import applying

SHAPE = (240, 320, 3)
LEAK = np.linspace(40, 0, 320)[None, :, None] * np.ones(SHAPE) + 4  # daylight from the left, and a black level


def write_dark(folder: Path, n: int = 12, level: float = 0.0) -> Path:
    folder.mkdir()
    rng = np.random.default_rng(1)
    for i in range(n):
        frame = LEAK + level + rng.normal(0, 1.5, SHAPE)
        cv2.imwrite(str(folder / f"{i:03}.png"), np.clip(np.round(frame), 0, 255).astype(np.uint8))
    return folder


def test_a_change_of_the_lamps_light_is_told_whatever_leaks_in(files: Files, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "dark.safetensors"
    code, text, err = run(
        "cal", "fit", "--only", "dark", write_dark(tmp_path / "log"), "--board", files.folder, "--out", out, "--json"
    )
    assert code == 0, err
    report = json.loads(text)
    assert report["frames"] == 12
    np.testing.assert_allclose(report["level_bgr"], LEAK.mean(), atol=0.2)
    assert report["noise"] == pytest.approx(1.5, abs=0.2)
    file = container.read(out)
    assert file.kinds == ["dark"]
    np.testing.assert_allclose(dark_of(file.tensors), LEAK, atol=2.5)
    lit = np.round(LEAK + 100).astype(np.uint8)
    pressed = np.round(LEAK + 120).astype(np.uint8)  # 20 % more of the lamps' light
    changes = []
    for data in (None, file.data):
        with Pipeline(files.board, data) as pipeline:
            pipeline.set_rest(lit)
            pipeline.process(pressed)
            changes.append(pipeline.raw("change")[..., 0] / 4096)
    assert changes[0].min() < 0.15
    np.testing.assert_allclose(changes[1], 0.20, atol=0.01)


def test_lamps_that_are_on_are_refused(files: Files, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "dark.safetensors"
    code, _, err = run(
        "cal", "fit", "--only", "dark", write_dark(tmp_path / "log", level=100), "--board", files.folder, "--out", out
    )
    assert code == 2
    assert "are the lamps off?" in err
    assert not out.exists()


def test_too_few_frames_and_other_sizes_are_refused(files: Files) -> None:
    frame = np.zeros(SHAPE, np.uint8)
    with pytest.raises(InputError, match="at least 8"):
        dark_frame(files.board, [frame] * 7)
    with pytest.raises(InputError, match="frame 8 is 100x50, board 'small' needs 320x240"):
        dark_frame(files.board, [*[frame] * 8, np.zeros((50, 100, 3), np.uint8)])
    assert dark_of(container.read(files.operator).tensors) is None


def test_a_dark_frame_of_another_size_is_refused_by_the_core(files: Files) -> None:
    tensors = {"dark.image": np.zeros((10, 10, 3), np.uint16)}
    with pytest.raises(InputError, match=r"dark\.image"):
        Pipeline(files.board, container.pack(tensors, container.base_metadata(files.board)).data)


@pytest.mark.parametrize("shape", [(10,), (240, 320)])
def test_a_dark_table_that_is_no_picture_is_one_sentence(tmp_path: Path, shape: tuple[int, ...]) -> None:
    presses = load_presses(write_presses(tmp_path / "presses", np.zeros(3)))
    with pytest.raises(InputError, match=f"an array of {' x '.join(map(str, shape))}, not rows x columns x 3"):
        presses.less(np.zeros(shape))


def write_presses(folder: Path, leak: np.ndarray) -> Path:
    """A ball of 4 mm at 15 px/mm in light that grows with the slope along x in blue and along y in red."""
    folder.mkdir()
    rng, lines = np.random.default_rng(7), ["image,center_x_px,center_y_px,contact_radius_px"]
    y, x = np.mgrid[:240, :320].astype(float)
    for i in range(-1, 4):
        cx, cy, radius = rng.uniform(40, 280), rng.uniform(40, 200), rng.uniform(12, 18)
        dx, dy = x - cx, y - cy
        inside = (np.hypot(dx, dy) < radius) & (i >= 0)
        light = np.stack([1 + 0.5 * dx / 30 * inside, np.ones_like(x), 1 + 0.5 * dy / 30 * inside], axis=-1)
        frame = np.clip(np.round(100 * light + leak + rng.normal(0, 0.5, SHAPE)), 0, 255).astype(np.uint8)
        name = "reference.png" if i < 0 else f"{i}.png"
        cv2.imwrite(str(folder / name), frame)
        lines += [f"{name},{cx:.2f},{cy:.2f},{radius:.2f}"] * (i >= 0)
    (folder / "presses.csv").write_text("\n".join(lines) + "\n")
    (folder / "presses.toml").write_text("ball_mm = 4.0\npx_per_mm = 15.0\n")
    return folder


def test_colours_are_fitted_without_what_leaks_in(files: Files, tmp_path: Path) -> None:
    clean, leaky = (load_presses(write_presses(tmp_path / n, k * LEAK)) for n, k in (("clean", 0), ("leaky", 1)))
    dark = replace(leaky, dark=LEAK)
    view = pad_view(files.board, {}, {})
    true, spoilt, told = (np.concatenate([s.change for s in collect_samples(p, view)]) for p in (clean, leaky, dark))
    gain_spoilt, gain_told = ((v * true).sum() / (true**2).sum() for v in (spoilt, told))
    assert gain_spoilt < 0.85
    assert gain_told == pytest.approx(1, abs=0.03)


def test_the_verb_fits_colours_with_it(files: Files, run: Run, tmp_path: Path) -> None:
    folder, out = write_presses(tmp_path / "presses", LEAK), tmp_path / "colours.safetensors"
    words = ("cal", "fit", "--only", "photometric", folder, "--board", files.folder, "--out", out, "--dark")
    code, _, err = run(*words, files.operator)
    assert code == 2
    assert "has no dark table: make one with `ruffini cal fit --only dark`" in err
    dark = container.pack({"dark.image": np.round(LEAK * 16).astype(np.uint16)}, container.base_metadata(files.board))
    container.write(tmp_path / "dark.safetensors", dark)
    assert run(*words, tmp_path / "dark.safetensors")[0] == 0
    assert container.read(out).kinds == ["photometric"]


def test_a_fit_keeps_the_dark_frame_that_was_in_force_and_fits_colours_with_it(
    files: Files, run: Run, tmp_path: Path
) -> None:
    """Without it the new colours would be of light that the board no longer takes off."""
    folder, out = write_presses(tmp_path / "presses", LEAK), tmp_path / "colours.safetensors"
    dark = container.pack({"dark.image": np.round(LEAK * 16).astype(np.uint16)}, container.base_metadata(files.board))
    container.write(tmp_path / "dark.safetensors", dark)
    words = ("cal", "fit", "--only", "photometric", folder, "--board", files.folder, "--out", out)
    assert run(*words, "--dark", tmp_path / "dark.safetensors")[0] == 0
    job = Job(files.board, [], previous=dark, balls=folder)
    for estimator in applying(files.board)[: applying(files.board).index(PHOTOMETRIC) + 1]:
        estimator.fit(job, lambda _: None)
    np.testing.assert_array_equal(job.tensors["dark.image"], dark.tensors["dark.image"])
    for name, tensor in container.read(out).tensors.items():
        np.testing.assert_array_equal(job.tensors[name], tensor, err_msg=name)
    colours = container.read(out).tensors
    assert run(*words, "--previous", tmp_path / "dark.safetensors")[0] == 0
    assert container.read(out).kinds == ["dark", "photometric"]
    for name, tensor in colours.items():
        np.testing.assert_array_equal(container.read(out).tensors[name], tensor, err_msg=name)
    small = container.pack({"dark.image": np.zeros((10, 10, 3), np.uint16)}, container.base_metadata(files.board))
    job = Job(files.board, [], parts=[small], balls=folder)
    DARK.fit(job, lambda _: None)
    with pytest.raises(InputError, match="the dark frame is 10x10, the presses are 320x240: measure it again"):
        PHOTOMETRIC.fit(job, lambda _: None)


def test_a_fit_keeps_the_lenses_of_several_views(files: Files) -> None:
    views = container.pack({"views.rays": np.zeros((2, 3), np.int32)}, container.base_metadata(files.board))
    job = Job(files.board, [], previous=views)
    assert CAMERA.fit(job, lambda _: None).state == "kept"
    assert "views.rays" in job.tensors
