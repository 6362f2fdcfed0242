"""Videos of a pressed gel with a load cell's CSV beside each: what is read, what is left out, what is refused."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.log.videos import VideoColumns, read_video_log
from ruffini.errors import InputError

N_FRAMES, N_REST, GLITCH = 20, 5, 12
COLUMNS = VideoColumns("load", "N", "frame", r"(.*)_\d", 10.0)


@pytest.fixture(scope="module")
def board() -> Board:
    """The wedge's, its picture four times smaller."""
    text = find_board("gelsight-wedge").text
    small = {"width_px = 640": "width_px = 160", "height_px = 480": "height_px = 120", "319500": "79500",
             "239500": "59500", "[67, 68], [465, 113]": "[10, 10], [150, 15]",
             "[475, 383], [73, 437]": "[148, 100], [12, 110]", "n_x = 10": "n_x = 4", "n_y = 8": "n_y = 3"}  # fmt: skip
    for large, little in small.items():
        assert large in text
        text = text.replace(large, little)
    return parse_board(text.encode(), "small wedge")


def forces() -> list[float]:
    """Rising and falling; one reading is 30 N off."""
    load = [0.0] * 8 + [1.0, 3.0, 5.0, 6.0, 6.0, 5.0, 3.0, 1.0] + [0.0] * 4
    load[GLITCH] -= 30
    return load


def write(video: Path, rows: list[str] | None = None) -> Path:
    """A picture whose middle gets brighter by four levels a newton."""
    out = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
    for k, load in enumerate(forces()):
        image = np.full((120, 160, 3), 100, np.uint8)
        image[40:80, 50:110] += np.uint8(4 * max(load if k != GLITCH else load + 30, 0))
        out.write(image)
    out.release()
    rows = rows or [f"{k},{load}" for k, load in enumerate(forces())]
    video.with_suffix(".csv").write_text("\n".join(["frame,load", *rows]) + "\n")
    return video


def test_each_video_is_a_run_of_its_object_and_glitches_are_named(tmp_path: Path, board: Board) -> None:
    for name in ("ball_0", "ball_1", "brick_0"):
        write(tmp_path / f"{name}.avi")
    (tmp_path / "corners.csv").write_text("no,video\n")
    log = read_video_log([tmp_path], board, COLUMNS)
    assert [run.name for run in log.runs] == ["ball_0", "ball_1", "brick_0"]
    assert [run.recording for run in log.runs] == ["ball", "ball", "brick"]
    assert log.remarks[0] == "ball_0.avi: frames left out, their readings jump or are missing: 11, 12, 13"
    used = [k for k in range(N_REST, N_FRAMES) if abs(k - GLITCH) > 1]
    run = log.runs[0]
    assert np.round(30 * run.time_s).tolist() == used
    assert (-run.reference[:, 2]).tolist() == [forces()[k] for k in used]
    assert not run.reference[:, [0, 1, 3, 4, 5]].any()
    assert run.features.shape == (len(used), 3 * 4 * 3)
    brightest = run.features[run.reference[:, 2].argmin()]
    middle = brightest.reshape(3, 3, 4)[:, 1, 1:3]
    assert (middle > 0.1 * 65536).all()  # 20 levels of 100 in most of these cells
    assert np.abs(run.features[0]).max() < 0.01 * 65536


def test_frames_without_a_row_are_left_out(tmp_path: Path, board: Board) -> None:
    video = write(tmp_path / "ball_0.avi", [f"{k},0.5" for k in range(0, N_FRAMES, 2)])
    run = read_video_log([video], board, COLUMNS).runs[0]
    assert np.round(30 * run.time_s).tolist() == list(range(6, N_FRAMES, 2))


@pytest.mark.parametrize(
    ("rows", "columns", "sentence"),
    [
        (None, VideoColumns("newtons"), "has no column 'newtons', only frame, load"),
        (["0,1", "0,2"], COLUMNS, "numbers must be 0 to 19, each once"),
        (["20,1"], COLUMNS, "numbers must be 0 to 19, each once"),
        (["0,1"], VideoColumns("load"), "has 1 rows, the video 20 frames: name the column"),
        (None, VideoColumns("load", recording="(x)"), "does not match recording"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, board: Board, rows: list[str] | None, columns: VideoColumns, sentence: str
) -> None:
    write(tmp_path / "ball_0.avi", rows)
    with pytest.raises(InputError, match=sentence):
        read_video_log([tmp_path], board, columns)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "force is not named"),
        ('force = "f"\nnewtons = "x"', "newtons: unknown; known are force, unit"),
        ("force = 1", "force must be text"),
        ('force = "f"\nlargest_jump = "10"', "largest_jump must be a number"),
        ('force = "f"\nunit = "stone"', "stone"),
        ('force = "f"\nrecording = "("', "is no regular expression"),
        ('force = "f"\nrecording = "ball"', "has no group"),
    ],
)
def test_a_mapping_file_that_is_none_is_refused(tmp_path: Path, text: str, sentence: str) -> None:
    (path := tmp_path / "videos.toml").write_text(text)
    with pytest.raises(InputError, match=sentence):
        VideoColumns.read(path)


def test_a_mapping_file_is_read(tmp_path: Path) -> None:
    (path := tmp_path / "videos.toml").write_text(
        'force = "load"\nframe = "frame"\nrecording = \'(.*)_\\d\'\nlargest_jump = 10'
    )
    assert VideoColumns.read(path) == COLUMNS


def test_a_folder_without_videos_is_refused(tmp_path: Path, board: Board) -> None:
    with pytest.raises(InputError, match="holds no video with a CSV file"):
        read_video_log([tmp_path], board, COLUMNS)
