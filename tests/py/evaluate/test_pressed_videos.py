"""Objects left out wholly, beside a load cell: made videos whose brightness follows the force."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pressed_gel import LEVELS_PER_N, small_wedge, write_video

from ruffini.boards import Board, boards_folder, parse_board
from ruffini.calibrate.log.videos import VideoColumns
from ruffini.calibrate.report.html import Page
from ruffini.errors import InputError
from ruffini.estimators.softness.model import mean_of
from ruffini.evaluate import pressed_videos
from ruffini.evaluate.pressed_videos import LOAD_CELL, PICTURES, Found, evaluate
from ruffini.evaluate.real import pressed_objects
from ruffini.evaluate.wrench import has_peers

COLUMNS = VideoColumns("load", "N", "frame", r"(.*)_\d")
LARGEST_N = 8.0
N_STILL = 35  # frames untouched: more than the first second


@pytest.fixture(scope="module")
def board() -> Board:
    return parse_board(small_wedge().encode(), "small wedge")


def write(folder: Path, name: str, gain: float = 1.0) -> None:
    """Two closings on one object; `gain`: of what its picture shows over what the load cell reads."""
    for k in range(2):
        load = np.concatenate([np.zeros(N_STILL), LARGEST_N * (1 - 0.2 * k) * np.sin(np.linspace(0, np.pi, 45)) ** 2])
        seed = sum(name.encode()) + k
        rows = [f"{i},{one:.4f}" for i, one in enumerate(load)]
        write_video(folder / f"{name}_{k}.avi", gain * load, rows, noise=2.0, seed=seed)


@pytest.fixture(scope="module")
def found(board: Board, tmp_path_factory: pytest.TempPathFactory) -> Found:
    """Three objects alike, and one whose picture shows half of its force."""
    folder = tmp_path_factory.mktemp("videos")
    for name in ("ball", "brick", "ring"):
        write(folder, name)
    write(folder, "odd", gain=0.5)
    return evaluate(folder, board, COLUMNS, peers=has_peers())


def test_each_object_is_judged_by_a_fit_that_did_not_see_it(found: Found) -> None:
    assert [closing.run.name for closing in found.closings] == [f"{n}_{k}" for n in ("ball", "brick", "odd", "ring")
                                                                for k in range(2)]  # fmt: skip
    errors = found.errors()
    # A fit that saw it would trade its error for those of the others: half of 8 N and 6.4 N, pressed half of the time.
    half_of_mean_n = np.mean([np.abs(c.truth).mean() / 2 for c in found.closings if c.run.recording == "odd"])
    assert errors["odd"] == pytest.approx(half_of_mean_n, rel=0.1)
    assert all(0.01 < errors[name] < 0.5 * errors["odd"] for name in ("ball", "brick", "ring"))
    odd = next(closing for closing in found.closings if closing.run.name == "odd_0")
    assert odd.force.min() == pytest.approx(-LARGEST_N / 2, rel=0.1)


def test_untouched_frames_and_the_share_within_sigma(found: Found) -> None:
    assert found.at_rest() < 0.2
    assert 0.3 < found.within(1.0) <= found.within(2.0) < 1.0
    assert found.within(1e9) == 1.0
    assert len(found.hidden()) == sum(int((c.force == 0).sum()) for c in found.closings)
    stated = sum(int((c.force != 0).sum()) for c in found.closings)
    hidden = [(np.abs(c.force - c.truth) <= c.sigma)[c.force == 0] for c in found.closings]
    n = sum(len(c.force) for c in found.closings)
    assert found.within(1.0) * n == pytest.approx(found.within_of_touched(1.0) * stated + np.concatenate(hidden).sum())


def test_the_table_says_what_a_picture_as_at_rest_hides(found: Found, monkeypatch: pytest.MonkeyPatch) -> None:
    """The untouched frames of one closing, and one frame of a press, state no force."""
    first = found.closings[0]
    pressed = int(np.abs(first.truth).argmax())
    silent = (np.abs(first.truth) < 1e-3) | (np.arange(len(first.truth)) == pressed)
    gated = replace(found, closings=[replace(first, force=np.where(silent, 0.0, first.force)), *found.closings[1:]])
    monkeypatch.setattr("ruffini.evaluate.real.pressed_videos.evaluate", lambda *_, **__: gated)
    mapping = boards_folder() / "gelsight-wedge" / "wedge-load-cell.videos.toml"
    rows = {r.figure: r.ours for r in pressed_objects(mapping, mapping.parent, Page("test"), lambda _: None)}
    assert rows["load cell on frames that state no force: largest"] == abs(first.truth[pressed]) > 1
    assert rows["load cell on frames that state no force: 99th percentile"] < 0.1
    assert rows["truths within two, of frames that state a force"] == pytest.approx(100 * gated.within_of_touched(2.0))


def squeezes(folder: Path, name: str, share: float) -> None:
    """The rim gets brighter with the force; in the middle lies a bowl, as deep as a rigid object's times `share`."""
    x, y = np.meshgrid(np.arange(160) - 80.0, np.arange(120) - 57.0)
    is_middle = (abs(x) < 42) & (abs(y) < 28)
    for k in range(2):
        load = np.concatenate([np.zeros(20), 5 * np.sin(np.linspace(0, np.pi, 45)) ** 2])
        rng = np.random.default_rng(sum(name.encode()) + k)
        out = cv2.VideoWriter(str(folder / f"{name}_{k}.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (160, 120))
        for one in load:
            image = np.full((120, 160, 3), 100.0)
            image[~is_middle] += LEVELS_PER_N * one
            bowl = share * (1 + 0.1 * k) * one**0.3 * np.stack([x, y, 0 * x], axis=-1)
            image += is_middle[..., None] * bowl
            out.write(np.clip(image + rng.normal(0, 1.0, image.shape), 0, 255).astype(np.uint8))
        out.release()
        rows = [f"{i},{one:.4f}" for i, one in enumerate(load)]
        (folder / f"{name}_{k}.csv").write_text("\n".join(["frame,load", *rows]) + "\n")


def test_like_objects_are_told_apart_by_a_fit_to_the_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = small_wedge().replace("n_x = 4", "n_x = 10").replace("n_y = 3", "n_y = 8")
    for name, share in {"steel": 1.0, "glass": 1.0, "soft": 0.3, "hard": 0.6, "same": 0.62}.items():
        squeezes(tmp_path, name, share)
    like = (("soft", "hard"), ("hard", "same"))
    columns = replace(COLUMNS, rigid=("steel", "glass"), squeeze_n=(0.7, 3.0), like=like)
    fitted: dict[str, list[set[str]]] = {"fit_softness": [], "fit_wrench_map": []}
    for name, seen in fitted.items():
        real = getattr(pressed_videos, name)

        def spy(runs: Any, *rest: Any, real: Any = real, seen: Any = seen, **named: Any) -> Any:
            seen.append({run.recording for run in runs})
            if (
                "nonlinear" in named and len(seen[-1]) > 3
            ):  # fits that judge one object, which the tests of `found` look at
                named["nonlinear"] = False
            return real(runs, *rest, **named)

        monkeypatch.setattr(pressed_videos, name, spy)
    found = evaluate(tmp_path, parse_board(text.encode(), "small wedge"), columns, peers=False)
    without = [{"steel", "glass", "same"}, {"steel", "glass", "soft"}]
    assert fitted["fit_softness"] == without
    assert fitted["fit_wrench_map"][-2:] == without
    assert list(found.pairs) == [LOAD_CELL, PICTURES]
    for told, alike in found.pairs.values():
        assert (told.softer, told.harder) == like[0]
        assert [len(shares) for shares in told.shares] == [2, 2]
        assert (told.is_told, told.is_right) == (True, True)
        assert told.chance < 0.001
        swapped = replace(told, softer="hard", harder="soft", shares=told.shares[::-1])
        assert (swapped.is_told, swapped.is_right) == (True, False)
        assert mean_of(told.shares[0]).log == pytest.approx(np.log2(0.3), abs=0.2)
        assert not alike.is_told
        assert 0.05 < alike.chance <= 0.5
    with pytest.raises(InputError, match="like: there is no recording of sofa"):
        evaluate(tmp_path, parse_board(text.encode(), "small wedge"), replace(columns, like=(("sofa", "hard"),)))
    with pytest.raises(InputError, match="rigid: there is no recording of glas, only of"):
        evaluate(tmp_path, parse_board(text.encode(), "small wedge"), replace(columns, rigid=("steel", "glas")))


def test_a_peer_is_judged_on_the_same_frames(found: Found) -> None:
    if not has_peers():
        pytest.skip("scikit-learn is not installed")
    assert found.has_peer
    assert found.errors("peer")["odd"] > 2 * found.errors("peer")["ball"]
    assert [len(c.peer) for c in found.closings if c.peer is not None] == [len(c.truth) for c in found.closings]


def test_the_picture_has_a_column_for_each_object(found: Found) -> None:
    figure = pressed_videos.picture(found)
    assert len(figure.axes) == 2 * 4  # type: ignore[attr-defined]


@pytest.mark.parametrize("names", [("ball",), ("ball", "brick")])
def test_fewer_than_three_objects_are_refused(board: Board, tmp_path: Path, names: tuple[str, ...]) -> None:
    for name in names:
        write(tmp_path, name)
    with pytest.raises(InputError, match=rf"videos of {len(names)} objects \({', '.join(names)}\): 3 are needed"):
        evaluate(tmp_path, board, COLUMNS, peers=False)
