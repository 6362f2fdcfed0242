"""ruffini cal fit --only threshold as typed: an untouched recording in, a kind that the core takes out."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from small_board import Files, Run

from ruffini.calibrate import container


def write_frames(folder: Path, n: int, level: int = 120) -> Path:
    """Grey with printed dots (base.toml: every 15 px), and noise."""
    folder.mkdir()
    rng = np.random.default_rng(3)
    y, x = np.mgrid[:240, :320]
    dots = np.hypot((x - 159.5 + 7.5) % 15 - 7.5, (y - 119.5 + 7.5) % 15 - 7.5) < 3
    for i in range(n):
        frame = level * np.where(dots, 0.4, 1.0)[..., None] + rng.normal(0, 1.5, (240, 320, 3))
        cv2.imwrite(str(folder / f"{i:04}.png"), np.clip(np.round(frame), 0, 255).astype(np.uint8))
    return folder


def coloured(files: Files, folder: Path) -> Path:
    """The board's calibration with a table that makes slopes of colours."""
    file = container.read(files.calibration)
    unmix = np.zeros((13, 17, 2, 3), np.int16)
    unmix[..., 0, 0] = unmix[..., 1, 2] = 8192
    q = np.linspace(-1, 1, 65)
    slope = np.round(1024 * np.stack(np.meshgrid(q, q), axis=-1)).astype(np.int16)
    tables = {**file.tensors, "photometric.unmix": unmix, "photometric.slope": slope}
    out = folder / "coloured.safetensors"
    container.write(out, container.pack(tables, file.metadata))
    return out


def test_an_untouched_recording_says_what_counts_as_a_touch(files: Files, run: Run, tmp_path: Path) -> None:
    out = tmp_path / "whole.safetensors"
    log, calibration = write_frames(tmp_path / "rest", 140), coloured(files, tmp_path)
    code, text, err = run(
        "cal",
        "fit",
        "--only",
        "threshold",
        log,
        "--previous",
        calibration,
        "--board",
        files.folder,
        "--out",
        out,
        "--json",
    )
    assert code == 0, err
    report = json.loads(text)["stages"]["threshold"]
    assert report["frames"] >= 100
    assert 0 < report["node_sigma_mn"] < report["square_mn"] < report["alone_mn"]
    file = container.read(out)
    assert set(file.kinds) == {*container.read(calibration).kinds, "contact"}
    stated_un = np.array([report["square_mn"], report["alone_mn"]]) * 1e3
    assert np.abs(file.tensors["contact.noise_un"] - stated_un).max() <= 1
    assert run("cal", "file", "verify", out, "--board", files.folder)[0] == 0


def test_a_calibration_without_colours_is_refused(files: Files, run: Run, tmp_path: Path) -> None:
    log, out = write_frames(tmp_path / "rest", 2), tmp_path / "contact.safetensors"
    code, _, err = run(
        "cal", "fit", "--only", "threshold", log, "--board", files.folder, "--previous", files.operator, "--out", out
    )
    assert code == 2
    assert "operator and photometric" in err
    assert not out.exists()


def test_dark_frames_are_refused(files: Files, run: Run, tmp_path: Path) -> None:
    log, out = write_frames(tmp_path / "rest", 30, level=5), tmp_path / "contact.safetensors"
    code, _, err = run(
        "cal", "fit", "--only", "threshold", log, "--board", files.folder, "--previous", files.calibration, "--out", out
    )
    assert code == 2
    assert "z is not measured" in err
