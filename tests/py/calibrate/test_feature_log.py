"""What `cal fit --only wrench` reads: logs of the rig, folders of frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from ruffini.boards import Board, find_board, parse_board
from ruffini.calibrate.fit.job import Job
from ruffini.errors import InputError
from ruffini.estimators.wrench.command import WrenchOptions
from ruffini.estimators.wrench.log import features_of, read_feature_runs, zero_of
from ruffini.estimators.wrench.stage import WRENCH
from ruffini.estimators.wrench.task import PRESSES
from ruffini.rig.log_file import Log, TouchRecord, write_log
from ruffini.rig.placed_weight import PlacedWeight

BOARD = find_board("ftouch")
WARM = parse_board(f'{BOARD.text}\n[temperature]\nplace = "sleeve"\npath = "/none"\n', "warm")
N = 6


def drawn(shift_px: float) -> npt.NDArray[np.uint8]:
    """The board's three targets, dark on grey, moved to the right."""
    y, x = np.mgrid[: BOARD.camera.height_px, : BOARD.camera.width_px]
    level = np.full(x.shape, 90.0)
    assert BOARD.targets is not None
    scale = BOARD.camera.focal_mpx / 1e3 / (BOARD.camera.standoff_um - BOARD.targets.below_um)
    for at_x, at_y in BOARD.targets.places_um:
        u = BOARD.camera.center_x_mpx / 1e3 + (at_x - BOARD.pad.size_x_um / 2) * scale + shift_px
        v = BOARD.camera.center_y_mpx / 1e3 + (at_y - BOARD.pad.size_y_um / 2) * scale
        level -= 78 * np.clip(BOARD.targets.diameter_um / 2 * scale + 0.5 - np.hypot(x - u, y - v), 0, 1)
    return np.repeat(np.round(level)[..., None], 3, axis=2).astype(np.uint8)


def touch(**arrays: npt.NDArray[np.generic]) -> TouchRecord:
    time_s = np.arange(N) * 0.1
    wrench = np.stack([0.1 * np.arange(N), *np.zeros((5, N))], axis=1)
    return TouchRecord({"session": "a"}, {
        "stream_s": time_s, "stream_host_s": time_s + 5.0,
        "stream_frame": np.arange(N), "stream_flags": np.zeros(N, int),
        "stream_wrench": np.full((N, 6), np.nan), "stream_validity": np.zeros((N, 6), int),
        "reference_s": time_s + 5.0, "reference_wrench": wrench, "stage_s": time_s, "stage_place": np.zeros((N, 3)),
        **arrays,
    })  # fmt: skip


def seen(moved: npt.NDArray[np.float64]) -> TouchRecord:
    return touch(marker_displacement=moved, marker_s=np.arange(N) * 0.1, marker_place=np.zeros((moved.shape[1], 2)))


def test_targets_of_a_log(tmp_path: Path) -> None:
    """Shifts in px and the change of area in px^2 become the core's integers."""
    moved = np.zeros((N, 3, 3))
    moved[2, 1] = (0.5, -0.25, 10.0)
    path = tmp_path / "log.h5"
    write_log(path, Log({"board": "ftouch", "marker_unit": "px"}, [seen(moved)], {}))
    (run,) = read_feature_runs([path], BOARD)
    assert run.features[2, 3:6] == pytest.approx([32768, -16384, 2560])
    assert run.at(0.0)[:, 0] == pytest.approx(0.1 * np.arange(N))  # both clocks are one


def test_a_log_without_pictures_or_of_another_board_is_refused(tmp_path: Path) -> None:
    write_log(tmp_path / "bare.h5", Log({"board": "ftouch"}, [touch()], {}))
    with pytest.raises(InputError, match="holds no targets in pixels"):
        read_feature_runs([tmp_path / "bare.h5"], BOARD)
    write_log(tmp_path / "other.h5", Log({"board": "gelslim"}, [touch()], {}))
    with pytest.raises(InputError, match="was collected on board 'gelslim'"):
        read_feature_runs([tmp_path / "other.h5"], BOARD)


def test_markers_of_a_log(tmp_path: Path) -> None:
    board = find_board("gelslim")
    assert board.markers is not None
    n = board.markers.n_x * board.markers.n_y
    moved = np.zeros((N, n, 2))
    moved[:, 3, 1] = 0.5
    path = tmp_path / "log.h5"
    facts = {"board": "gelslim", "marker_unit": "px"}
    write_log(path, Log(facts, [seen(moved)], {}))
    (run,) = read_feature_runs([path], board)
    assert run.features.shape == (N, 2 * n)
    assert run.features[2, 7] == 0.5 * 65536


def of_a_picture(held_s: tuple[float, float], **arrays: npt.NDArray[np.generic]) -> TouchRecord:
    """A touch on a gel without markers; the first feature counts frames."""
    features = np.zeros((N, 3 * 12 * 9), np.int32)
    features[:, 0] = 10 * np.arange(N)
    record = touch(feature=features, feature_s=np.arange(N) * 0.1, **arrays)
    return record._replace(facts={"held_host_s": held_s[0], "lifted_host_s": held_s[1]})


def test_features_of_a_gel_without_markers_and_the_axes_that_it_measures(tmp_path: Path) -> None:
    """A load cell of one axis knows no shear (NaN), and of one with six the gel tells the normal force alone."""
    board, wrench = find_board("digit-tactile"), np.full((N, 6), np.nan)
    wrench[:, 2] = -np.arange(N)
    sheared = np.tile(wrench[:, 2:3], (1, 6))
    path = tmp_path / "log.h5"
    touches = [of_a_picture((5.25, 5.45), reference_wrench=each) for each in (wrench, sheared)]
    write_log(path, Log({"board": "digit-tactile"}, touches, {}))
    for run in read_feature_runs([path], board):
        assert run.features[:, 0].tolist() == [0, 10, 20, 30, 40, 50]
        assert run.at(0.0)[:, 2] == pytest.approx(-np.arange(N))
        assert (run.at(0.0)[:, [0, 1, 3, 4, 5]] == 0).all()
    write_log(path, Log({"board": "gelsight-wedge"}, touches, {}))
    with pytest.raises(InputError, match="324 numbers of picture a frame, the board has 240"):
        read_feature_runs([path], find_board("gelsight-wedge"))
    write_log(path, Log({"board": "digit-tactile"}, [touch()], {}))
    with pytest.raises(InputError, match=r"holds no features of its picture: .* collect it again"):
        read_feature_runs([path], board)


def moments_board() -> Board:
    board = find_board("digit-tactile")
    stages = '"difference", "photometric", "poisson", "depth_moments", "feature_wrench"'
    head = board.text[: board.text.index("stages = ")]
    section = head[head.index("[picture_features]") : head.index("[depth]")]
    return parse_board(f"{head.replace(section, '')}stages = [{stages}]\n", "digit-tactile")


def test_moments_of_depth_of_a_log(tmp_path: Path) -> None:
    """The board's integers as FEATURES sends them, and the straight presses of a gel without markers."""
    board, path = moments_board(), tmp_path / "log.h5"
    assert features_of(board) == ("depth", 8, None, True)
    assert WRENCH.task_of(board) is PRESSES
    moments = 1000 * np.arange(N * 8, dtype=np.int32).reshape(N, 8)
    record = touch(feature=moments, feature_s=np.arange(N) * 0.1)
    write_log(path, Log({"board": "digit-tactile"}, [record], {}))
    (run,) = read_feature_runs([path], board)
    assert run.features.tolist() == moments.tolist()
    write_log(path, Log({"board": "digit-tactile"}, [touch()], {}))
    with pytest.raises(InputError, match="once it is calibrated: collect it again"):
        read_feature_runs([path], board)


def test_presses_of_one_ball_fit_moments_of_depth_and_claim_no_other_kind_of_contact(tmp_path: Path) -> None:
    """Force in proportion to the volume; the other moments vary from touch to touch."""
    board, path, rng = moments_board(), tmp_path / "log.h5", np.random.default_rng(4)
    touches = []
    for _ in range(20):
        force = rng.uniform(0.5, 2.0) * np.minimum(np.arange(N), 3) / 3
        moments = np.stack([2e5 * force, *(rng.uniform(-1e5, 1e5, (7, 1)) * force)], axis=1) + rng.normal(0, 20, (N, 8))
        wrench = np.zeros((N, 6))
        wrench[:, 2] = -force
        arrays = {"feature": moments.round().astype(np.int32), "feature_s": np.arange(N) * 0.1}
        touches.append(touch(reference_wrench=wrench, **arrays))
    write_log(path, Log({"board": "digit-tactile"}, touches, {}))
    job = Job(board, [path])
    outcome = WRENCH.fit(job, lambda _: None)
    assert job.metadata["wrench.features"] == "depth"
    assert outcome.report["axes"]["Fz"]["rmse"] < 0.02
    assert [line for line in outcome.remarks if "1 of 5 kinds of contact" in line]
    sigma, full = (
        np.sqrt((job.tensors["wrench.error"][1].astype(float) ** 2).sum(axis=0)),
        job.tensors["wrench.full_scale"],
    )
    assert 0.49 < sigma[2] / full[2] < 0.6


def test_frames_tell_no_moments_of_depth_without_the_units_colours(tmp_path: Path) -> None:
    board = moments_board()
    (tmp_path / "frames").mkdir()
    grey = np.full((board.camera.height_px, board.camera.width_px, 3), 90, np.uint8)
    n = board.pipeline.n_rest_frames + 2
    for i in range(n):
        cv2.imwrite(str(tmp_path / "frames" / f"{i:04d}.png"), grey)
    (tmp_path / "wrench.csv").write_text("fx,fy,fz,tx,ty,tz\n" + n * "0,0,-1,0,0,0\n")
    with pytest.raises(InputError, match="which pictures without a calibration of their unit do not tell"):
        read_feature_runs([tmp_path], board)
    with pytest.raises(
        InputError, match=r"videos.toml: .* which pictures without a calibration of their unit do not tell"
    ):
        WRENCH.fit_alone(Job(board, [tmp_path]), WrenchOptions(videos=tmp_path / "videos.toml"), lambda _: None)


def test_what_pressed_is_the_tip_and_not_the_log(tmp_path: Path) -> None:
    """Five logs of one ball are one kind of contact, and so are logs that name no tip."""
    ball, cone = {"shape": "sphere", "radius_m": 3e-3}, {"shape": "cone", "radius_m": 3e-3}
    kinds = []
    for i, tip in enumerate((ball, dict(reversed(ball.items())), cone, None, None)):
        path = tmp_path / f"{i}.h5"
        write_log(path, Log({"board": "digit-tactile", "tip": tip}, [of_a_picture((5.25, 5.45))], {}))
        kinds += [run.kind for run in read_feature_runs([path], find_board("digit-tactile"))]
    assert kinds[0] == kinds[1]
    assert len(set(kinds)) == 3


def test_a_typed_reading_counts_once_and_only_while_it_is_held(tmp_path: Path) -> None:
    """The scale's number is right in the frames 3 and 4 and says nothing of the way there."""
    wrench = np.full((N, 6), np.nan)
    wrench[:, 2] = [0, 0, 0, -2.0, -2.0, 0]
    touches = [of_a_picture((5.25, 5.45), reference_wrench=wrench)]
    found = {"reference": {"name": PlacedWeight(2.0).facts.name}}
    write_log(tmp_path / "log.h5", Log({"board": "digit-tactile"}, touches, found))
    (run,) = read_feature_runs([tmp_path / "log.h5"], find_board("digit-tactile"))
    assert run.features[:, 0].tolist() == [0, 35]
    assert run.at(0.0)[:, 2].tolist() == [0, -2.0]


def test_frames_with_a_csv(tmp_path: Path) -> None:
    n = BOARD.pipeline.n_rest_frames + 3
    for i in range(n):
        cv2.imwrite(str(tmp_path / f"{i:03d}.png"), drawn(0.0 if i < n - 2 else 2.0))
    rows = ["fx,fy,fz,tx,ty,tz", *(f"{0.5 if i >= n - 2 else 0},0,0,0,0,0" for i in range(n))]
    (tmp_path / "wrench.csv").write_text("\n".join(rows) + "\n")
    (run,) = read_feature_runs([tmp_path], BOARD)
    assert run.features[-1, 0] / 65536 == pytest.approx(2.0, abs=0.02)
    assert run.at(0.0)[-1, 0] == pytest.approx(0.5)
    (tmp_path / "wrench.csv").write_text("\n".join(rows[:-1]) + "\n")
    with pytest.raises(InputError, match="one row a frame"):
        read_feature_runs([tmp_path], BOARD)


def test_of_frames_too_a_board_learns_only_the_axes_that_it_measures(tmp_path: Path) -> None:
    board, rng = find_board("digit-tactile"), np.random.default_rng(1)
    n, size = board.pipeline.n_rest_frames + 3, (board.camera.height_px, board.camera.width_px, 3)
    for i in range(n):
        cv2.imwrite(str(tmp_path / f"{i:03d}.png"), rng.integers(100, 104, size, dtype=np.uint8))
    rows = [f"{k},{k},{-k},{k},{k},{k}" for k in [0] * (n - 2) + [1, 2]]
    (tmp_path / "wrench.csv").write_text("\n".join(["fx,fy,fz,tx,ty,tz", *rows]) + "\n")
    (run,) = read_feature_runs([tmp_path], board)
    assert run.at(0.0)[-2:, 2].tolist() == [-1, -2]
    assert (run.at(0.0)[:, [0, 1, 3, 4, 5]] == 0).all()


def test_temperature_of_frames_is_a_column_of_the_csv(tmp_path: Path) -> None:
    n = BOARD.pipeline.n_rest_frames + 3
    rows = ["fx,fy,fz,tx,ty,tz,celsius"]
    for i in range(n):
        cv2.imwrite(str(tmp_path / f"{i:03d}.png"), drawn(0.0))
        rows.append(f"0,0,0,0,0,0,{20 + i}")
    (tmp_path / "wrench.csv").write_text("\n".join(rows) + "\n")
    (run,) = read_feature_runs([tmp_path], WARM)
    assert run.degrees is not None
    assert run.degrees.now == pytest.approx([20 + n - 3, 20 + n - 2, 20 + n - 1])
    assert run.degrees.rest == pytest.approx([20 + n - 4] * 3)
    (run,) = read_feature_runs([tmp_path], BOARD)
    assert run.degrees is None  # this board has no thermometer


def test_temperature_of_a_log_is_what_status_said(tmp_path: Path) -> None:
    """By the board's own thermometer; a session's rest is as warm as its first touch."""
    said = ({"sleeve": 24.5, "lamp": 50.0}, {"sleeve": 31.0}, {"lamp": 50.0})
    touches = [seen(np.zeros((N, 3, 3))) for _ in said]
    for each, celsius in zip(touches, said, strict=True):
        each.facts["temperatures_c"] = celsius
    write_log(tmp_path / "log.h5", Log({"board": "ftouch", "marker_unit": "px"}, touches, {}))
    degrees = [run.degrees for run in read_feature_runs([tmp_path / "log.h5"], WARM)]
    assert [d.now[0] for d in degrees if d] == pytest.approx([24.5, 31.0, np.nan], nan_ok=True)
    assert [d.rest[0] for d in degrees if d] == pytest.approx([24.5, 24.5, 24.5])


def test_a_reference_that_is_not_zero_at_rest_is_taken_off() -> None:
    """A bias of each recording would look like a wrench that no feature tells; mere noise is left as it is."""
    rng = np.random.default_rng(2)
    noise = rng.normal(size=(200, 12, 6)) * 0.1
    assert all((zero_of(each) == 0).all() for each in noise)
    bias = np.array([1.0, 0, -2.0, 0, 0, 0.7])
    assert zero_of(noise[0] + bias)[[0, 2, 5]] == pytest.approx([1.0, -2.0, 0.7], abs=0.15)
    assert (zero_of(noise[0] + bias)[[1, 3, 4]] == 0).all()
    assert (zero_of(noise[0, :3] + bias) == 0).all()  # too few to tell
