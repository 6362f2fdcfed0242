"""The stereo paper's network: samples, frozen features, training that can be cut, ONNX through OpenCV."""

import csv
import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from ruffini.boards import find_board
from ruffini.cli.app import app
from ruffini.errors import InputError, VerifyError
from ruffini.train import stereo_frames
from ruffini.train.stereo_predict import StereoNetwork, metadata_of

BOARD = find_board("stereo-fingertip")
N_PRESSES, N_FRAMES, N_PASSES = 10, 6, 2
N_REST = 3
NO_TORCH = "needs the extra [train]"


def drawn(force_n: float, x_mm: float, rng: np.random.Generator) -> np.ndarray:
    """Two views in which a bright patch grows with the force and moves with the place."""
    picture = np.zeros((BOARD.camera.height_px, BOARD.camera.width_px, 3))
    for left, aside in ((0, 0), (BOARD.camera.width_px // 2, 30)):
        at = (round(left + 149 + aside + 8 * x_mm), 120)
        cv2.circle(picture, at, round(10 + 40 * force_n), (80, 120, 160), -1)
    return np.clip(picture + rng.normal(20, 2, picture.shape), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def presses(tmp_path_factory):
    """Each: three untouched frames, then a force that grows beyond the paper's 1 N."""
    root, rng = tmp_path_factory.mktemp("presses"), np.random.default_rng(1)
    for press in range(N_PRESSES):
        folder = root / f"{press:02d}"
        (folder / "frames").mkdir(parents=True)
        x_mm = rng.uniform(-5, 5)
        with (folder / "press.csv").open("w", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["force_n", "way_mm", "x_mm", "y_mm", "roll_deg", "pitch_deg", "area_mm2"])
            for i in range(N_REST + N_FRAMES):
                force = max(i - N_REST + 1, 0) * 0.2
                rows.writerow([force, force / 2, x_mm, -x_mm, 3 * x_mm, 1.0 * i, 50] if force else [""] * 7)
                cv2.imwrite(str(folder / "frames" / f"{i:03d}.png"), drawn(force, x_mm, rng))
    (root / "00" / "run.json").write_text(json.dumps({"simulated": True}))
    return root


@pytest.fixture(scope="module")
def samples(presses):
    return stereo_frames.read_samples(BOARD, presses, "*")


@pytest.fixture
def torch(monkeypatch, tmp_path):
    """PyTorch on one thread, a cache of its own, and a network that is small enough for a test."""
    torch = pytest.importorskip("torch", reason=NO_TORCH)
    pytest.importorskip("onnx", reason=NO_TORCH)
    from ruffini.train import stereo_fit, stereo_network

    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    small = {p.name: replace(p, widths=(2, 2, 3, 3, 4), units=16, dropout=0.1) for p in stereo_network.PLANS.values()}
    monkeypatch.setattr(stereo_network, "PLANS", small)
    monkeypatch.setattr(stereo_fit, "PLANS", small)
    monkeypatch.setattr(stereo_fit, "RATE", dict.fromkeys(small, 3e-3))
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)


def trainer_of(samples, folder, n_passes=N_PASSES, mode=1, weights=None):
    from ruffini.train.stereo_fit import Choice, StereoTrainer

    plan, digest = ("eighth", None) if weights is None else ("vgg16", str(weights))
    return StereoTrainer(Choice(plan, mode, n_passes, 3, digest), samples, folder, weights)


def weights_file(torch, path):
    """As torchvision keeps VGG16 with batch norm: convolutions under features., a classifier that is not wanted."""
    from ruffini.train.stereo_network import PLANS, trunk_of

    torch.manual_seed(7)
    state = {f"features.{name}": value for name, value in trunk_of(PLANS["vgg16"]).state_dict().items()}
    torch.save({**state, "classifier.0.weight": torch.zeros(2, 2)}, path)
    return state


def test_samples_are_touched_frames_up_to_one_newton_and_some_untouched_ones(samples, presses):
    assert samples.views.shape == (N_PRESSES * 7, 2, 192, 224)  # 5 of 0.2 to 1.0 N, 2 of the untouched
    assert samples.press.tolist() == sorted(list(range(N_PRESSES)) * 7)
    first = samples.labels[:7]
    assert first[:, 0].tolist() == pytest.approx([0, 0, 2e5, 4e5, 6e5, 8e5, 1e6])  # uN
    assert np.isnan(first[:2, 1:]).all()
    x_um = first[2, 2]
    assert first[4, 1:].tolist() == pytest.approx([300, x_um, -x_um, np.deg2rad(3e3 * x_um), np.deg2rad(5e6)])
    assert samples.range_of(5e4)[0].tolist() == pytest.approx([5e4, 1e6])
    assert stereo_frames.read_samples(BOARD, presses, "00", most_n=10.0).labels[:, 0].max() == pytest.approx(1.2e6)


def test_the_region_is_the_papers_in_both_views():
    picture = np.zeros((240, 640, 3), np.uint8)
    picture[24, 47] = picture[215, 320 + 270] = [10, 20, 30]
    left, right = stereo_frames.views_of(picture)
    grey = round(0.114 * 10 + 0.587 * 20 + 0.299 * 30)
    assert (left[0, 0], left.sum()) == (grey, grey)
    assert (right[-1, -1], right.sum()) == (grey, grey)


def test_a_board_without_two_views_is_refused(presses):
    with pytest.raises(InputError, match="two views"):
        stereo_frames.read_samples(find_board("gelslim"), presses, "*")


def test_presses_that_never_touch_are_refused(presses, tmp_path):
    shutil.copytree(presses / "00", tmp_path / "00")
    text = (tmp_path / "00" / "press.csv").read_text().splitlines()
    (tmp_path / "00" / "press.csv").write_text("\n".join([text[0], *[",,,,,,"] * (len(text) - 1)]))
    with pytest.raises(InputError, match="nothing to learn from"):
        stereo_frames.read_samples(BOARD, tmp_path, "*")


def test_a_label_that_never_changes_is_learned_as_it_is(samples, tmp_path, torch):
    labels = np.where(np.arange(6) == 4, np.where(np.isnan(samples.labels), np.nan, 1234.0), samples.labels)
    trainer = trainer_of(replace(samples, labels=labels), tmp_path, n_passes=1)
    [done] = trainer.run()
    assert np.isfinite(done.loss)
    assert np.isfinite(done.error).all()
    with torch.no_grad():
        said = trainer.best()[0](torch.zeros(1, 3, 240, 640))[0]
    assert said[4] == pytest.approx(1234, abs=3)


def test_a_run_that_was_cut_ends_with_the_same_weights(samples, tmp_path, torch):
    whole = trainer_of(samples, tmp_path / "whole")
    passes = list(whole.run())
    assert passes[-1].loss < 0.9 * passes[0].loss  # it learns
    cut = trainer_of(samples, tmp_path / "cut")
    next(run := cut.run())
    run.close()
    again = trainer_of(samples, tmp_path / "cut")
    assert list(again.run()) == passes[1:]
    for a, b in zip(whole.best()[0].state_dict().values(), again.best()[0].state_dict().values(), strict=True):
        assert torch.equal(a, b)
    assert whole.best()[1].score == min(p.score for p in passes)
    with pytest.raises(InputError, match="give the same options"):
        trainer_of(samples, tmp_path / "cut", mode=2)


def test_opencv_says_the_same_as_pytorch_in_every_mode(samples, tmp_path, torch, monkeypatch):
    from ruffini.train import stereo_export

    rng = np.random.default_rng(2)
    pictures = [drawn(0.5, 1.0, rng), rng.integers(0, 256, (240, 640, 3)).astype(np.uint8)]
    said = []
    for mode in range(4):
        trainer = trainer_of(samples, tmp_path / str(mode), n_passes=1, mode=mode)
        list(trainer.run())
        net, path = trainer.best()[0], tmp_path / f"{mode}.onnx"
        assert stereo_export.export(net, BOARD, samples, pictures, path, True) < 1e-4
        said.append(StereoNetwork(path, BOARD).raw(pictures[0]) / net.span.numpy())
        with torch.no_grad():
            from_views = net.from_views(torch.from_numpy(stereo_frames.views_of(pictures[0])[None]).float())[0]
        # It is trained on grey levels that are rounded, and sees those of the whole frame as they are.
        assert (from_views + net.low / net.span).numpy() == pytest.approx(said[-1], abs=0.02)
    assert min(np.abs(a - b).max() for i, a in enumerate(said) for b in said[:i]) > 1e-4

    given = metadata_of(path)
    assert given["ruffini.outputs"].split(",") == list(stereo_frames.OUTPUTS)
    assert (given["ruffini.board"], given["ruffini.simulated"]) == ("stereo-fingertip", "true")
    low, high = (np.array(given[f"ruffini.{end}"].split(","), dtype=float) for end in ("low", "high"))
    assert low[0] == BOARD.contact.threshold_un
    assert high[0] == pytest.approx(1e6 + 0.05 * (1e6 - 5e4))
    raw_of_another = StereoNetwork(tmp_path / "0.onnx", BOARD).raw
    monkeypatch.setattr(StereoNetwork, "raw", lambda self, picture: raw_of_another(picture))
    with pytest.raises(VerifyError, match="off PyTorch"):
        stereo_export.export(net, BOARD, samples, pictures, path, True)


def test_a_frozen_trunk_keeps_its_weights_and_its_features_are_kept(samples, tmp_path, torch, monkeypatch):
    from ruffini.train.stereo_network import StereoNet

    state = weights_file(torch, tmp_path / "vgg16_bn-test.pth")
    trainer = trainer_of(samples, tmp_path / "run", weights=tmp_path / "vgg16_bn-test.pth")
    passes = list(trainer.run())
    assert passes[-1].loss < passes[0].loss
    net = trainer.best()[0]
    for name, value in net.trunk.state_dict().items():
        assert torch.equal(value, state[f"features.{name}"]), name

    monkeypatch.setattr(StereoNet, "features", lambda *a: pytest.fail("computed again"))
    again = trainer_of(samples, tmp_path / "run", weights=tmp_path / "vgg16_bn-test.pth")
    assert again.passes == passes

    (tmp_path / "text.pth").write_text("no weights")
    with pytest.raises(InputError, match="not torchvision's weights"):
        trainer_of(samples, tmp_path / "other", weights=tmp_path / "text.pth")


def test_the_verb_says_which_network_it_trains(presses, tmp_path, torch):
    argv = ["train", "stereo", "--board", "stereo-fingertip", "--presses", str(presses), "--passes", "1", "--json"]
    told = CliRunner().invoke(app, [*argv, "--out", str(tmp_path / "thin")])
    assert "it is not the paper's network" in told.stderr
    result = json.loads(told.stdout)
    assert (result["plan"], result["trunk"], result["simulated"]) == ("eighth", "trained from nothing", True)
    assert (result["presses"], result["frames"]) == (N_PRESSES, 7 * N_PRESSES)
    assert result["opencv_off_pytorch"] < 1e-4
    assert StereoNetwork(tmp_path / "thin" / "stereo.onnx", BOARD).outputs == list(stereo_frames.OUTPUTS)

    folder = tmp_path / "torch" / "hub" / "checkpoints"  # torchvision's cache
    folder.mkdir(parents=True)
    weights_file(torch, folder / "vgg16_bn-test.pth")
    result = json.loads(CliRunner().invoke(app, [*argv, "--out", str(tmp_path / "vgg")]).stdout)
    assert (result["plan"], result["trunk"]) == ("vgg16", "torchvision, frozen")
    no = CliRunner().invoke(app, [*argv, "--out", str(tmp_path / "no"), "--plan", "eighth", "--weights", "w.pth"])
    assert isinstance(no.exception, InputError)


def test_a_file_that_is_no_network_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such network"):
        StereoNetwork(tmp_path / "none.onnx", BOARD)
    for name, data in {"text": b"no network", "empty": b"", "cut": b"\x3a\xff\xff\xff\xff\xff\xff"}.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(InputError):
            StereoNetwork(tmp_path / name, BOARD)
