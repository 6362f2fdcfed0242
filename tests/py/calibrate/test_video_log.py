"""Videos of a pressed gel with a load cell's CSV beside each: what is read, what is left out, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pressed_gel import small_wedge, write_video

from ruffini.boards import Board, parse_board
from ruffini.calibrate.log.videos import VideoColumns, read_video_log
from ruffini.errors import InputError
from ruffini.frames import read_frames

N_FRAMES, N_REST, GLITCH = 20, 5, 12
COLUMNS = VideoColumns("load", "N", "frame", r"(.*)_\d", 10.0)


@pytest.fixture(scope="module")
def board() -> Board:
    return parse_board(small_wedge().encode(), "small wedge")


def forces() -> list[float]:
    """Rising and falling; one reading is 30 N off."""
    load = [0.0] * 8 + [1.0, 3.0, 5.0, 6.0, 6.0, 5.0, 3.0, 1.0] + [0.0] * 4
    load[GLITCH] -= 30
    return load


def write(video: Path, rows: list[str] | None = None) -> Path:
    """The picture follows the force; the glitch is the load cell's alone."""
    seen = [max(load if k != GLITCH else load + 30, 0) for k, load in enumerate(forces())]
    return write_video(video, seen, [f"{k},{load}" for k, load in enumerate(forces())] if rows is None else rows)


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


def test_what_the_load_cell_reads_at_rest_is_its_zero_and_is_said(tmp_path: Path, board: Board) -> None:
    write(tmp_path / "ball_0.avi", [f"{k},{load + 0.6}" for k, load in enumerate(forces())])
    log = read_video_log([tmp_path], board, COLUMNS)
    assert "ball_0.avi: the load cell read 0.60 N while rest was learned: taken off as its zero" in log.remarks
    used = [k for k in range(N_REST, N_FRAMES) if abs(k - GLITCH) > 1]
    assert -log.runs[0].reference[:, 2] == pytest.approx([forces()[k] for k in used])
    write(tmp_path / "ball_0.avi", [f"{k},{load + 0.6}" for k, load in enumerate(forces()) if k >= N_REST])
    assert -read_video_log([tmp_path], board, COLUMNS).runs[0].reference[0, 2] == 0.6, "no row of the rest: no zero"


def test_frames_without_a_row_are_left_out(tmp_path: Path, board: Board) -> None:
    video = write(tmp_path / "ball_0.avi", [f"{k},0.5" for k in range(0, N_FRAMES, 2)])
    run = read_video_log([video], board, COLUMNS).runs[0]
    assert np.round(30 * run.time_s).tolist() == list(range(6, N_FRAMES, 2))


@pytest.mark.parametrize(
    ("rows", "columns", "sentence"),
    [
        (None, VideoColumns("newtons"), "has no column 'newtons', only frame, load"),
        (["0,1", "0,2"], COLUMNS, "numbers must be whole, 0 to 19, each once"),
        (["20,1"], COLUMNS, "numbers must be whole, 0 to 19, each once"),
        (["-1,1"], COLUMNS, "numbers must be whole, 0 to 19, each once"),
        (["6,1", "7.7,1"], COLUMNS, "numbers must be whole, 0 to 19, each once"),
        ([], COLUMNS, "has a header and no rows"),
        ([], VideoColumns("load"), "has a header and no rows"),
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
        ('force = "f"\nrigid = "ball"', "rigid must be a list of names"),
        ('force = "f"\nrigid = ["ball"]', "rigid needs squeeze_n"),
        ('force = "f"\nrigid = ["ball"]\nsqueeze_n = [3, 1]', "squeeze_n must be two rising forces above zero"),
        ('force = "f"\nlike = [["a", "b"]]', "like needs rigid"),
        ('force = "f"\nmodulus_pa = { a = 0 }', "modulus_pa must be a table of moduli above zero"),
        ('force = "f"\nmodulus_pa = { a = inf }', "modulus_pa must be a table of moduli above zero"),
        (f'force = "f"\nlargest_jump = 1{"0" * 400}', "largest_jump must be a number"),
        (f'force = "f"\nlargest_jump = 1{"0" * 5000}', "cannot be read"),
        (f'force = "f"\nrigid = {"[" * 5000}', "cannot be read"),
        ('force = "f"\nrigid = ["a"]\nsqueeze_n = [1, 3]\nlike = [["b", "b"]]', "like names an object twice"),
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


@pytest.mark.parametrize("value", ["-1", "0", "nan"])
def test_a_largest_jump_that_is_no_size_is_refused(tmp_path: Path, value: str) -> None:
    (path := tmp_path / "videos.toml").write_text(f'force = "load"\nlargest_jump = {value}')
    with pytest.raises(InputError, match=f"largest_jump must be above zero, is {value}"):
        VideoColumns.read(path)


def test_a_folder_without_videos_is_refused(tmp_path: Path, board: Board) -> None:
    with pytest.raises(InputError, match="holds no video with a CSV file"):
        read_video_log([tmp_path], board, COLUMNS)
    with pytest.raises(InputError, match="nothing: there is no such file or folder"):
        read_video_log([tmp_path / "nothing"], board, COLUMNS)
    write(tmp_path / "ball_0.avi")
    (tmp_path / "ball_0.csv").unlink()
    with pytest.raises(InputError, match=r"ball_0\.avi: is no video with a CSV file"):
        read_video_log([tmp_path / "ball_0.avi"], board, COLUMNS)


def test_a_video_in_capitals_is_read_and_one_without_readings_is_named(tmp_path: Path, board: Board) -> None:
    write(tmp_path / "ball_0.avi").rename(tmp_path / "ball_0.AVI")
    write(tmp_path / "brick_0.avi").with_suffix(".csv").unlink()
    log = read_video_log([tmp_path], board, COLUMNS)
    assert [run.name for run in log.runs] == ["ball_0"]
    assert "brick_0.avi: left out, no brick_0.csv is beside it" in log.remarks


def test_two_videos_of_one_name_are_refused(tmp_path: Path, board: Board) -> None:
    (tmp_path / "monday").mkdir()
    paths = [write(tmp_path / "ball_0.avi"), write(tmp_path / "monday" / "ball_0.avi")]
    with pytest.raises(InputError, match="has the same name"):
        read_video_log(paths, board, COLUMNS)
    (tmp_path / "ball_0.mkv").write_bytes(b"")
    with pytest.raises(InputError, match="has the same name"):
        read_video_log([tmp_path], board, COLUMNS)


def test_rows_in_another_order_are_the_same(tmp_path: Path, board: Board) -> None:
    rows = [f"{k},{load}" for k, load in enumerate(forces())]
    sorted_, mixed = (
        read_video_log([write(tmp_path / "ball_0.avi", these)], board, COLUMNS)
        for these in (rows, rows[::3] + rows[1::3] + rows[2::3])
    )
    assert mixed.remarks == sorted_.remarks
    np.testing.assert_array_equal(mixed.runs[0].reference, sorted_.runs[0].reference)


@pytest.mark.parametrize("stated", [N_FRAMES - 4, N_FRAMES + 1])
def test_frames_are_counted_whatever_the_container_states(tmp_path: Path, board: Board, stated: int) -> None:
    video = write(tmp_path / "ball_0.avi")
    data = bytearray(video.read_bytes())
    length = data.index(b"strh") + 8 + 32  # of AVI's stream header: dwLength
    assert int.from_bytes(data[length : length + 4], "little") == N_FRAMES
    data[length : length + 4] = stated.to_bytes(4, "little")
    video.write_bytes(data)
    assert len(read_frames(video)) == stated
    run = read_video_log([video], board, VideoColumns("load")).runs[0]
    assert np.round(30 * run.time_s).tolist() == list(range(N_REST, N_FRAMES))
