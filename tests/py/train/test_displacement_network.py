"""The trained displacement network: samples of the twin, training that can be cut, ONNX through OpenCV."""

import numpy as np
import pytest

from ruffini.boards import find_board
from ruffini.errors import InputError
from ruffini.train import presses
from ruffini.train.predict import DisplacementNetwork

N_PRESSES, N_PASSES, SEED = 10, 4, 3
NO_TORCH = "needs the extra [train]"


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "train-cache"))
    monkeypatch.setattr(presses, "PRESSES_A_FILE", 5)


def samples_of(board, n=N_PRESSES):
    return presses.make_samples(board, n, SEED)


def test_shrinking_takes_means_and_leaves_out_what_fills_no_pixel():
    picture = np.zeros((5, 7, 3), np.uint8)
    picture[:2, :2] = [[[0, 10, 20], [4, 10, 20]], [[8, 10, 20], [12, 30, 20]]]
    small = presses.shrunk(picture, 2)
    assert small.shape == (2, 3, 3)
    assert small[0, 0].tolist() == [6, 15, 20]


def test_a_press_follows_from_the_seed_and_its_number_alone(coarse_board):
    rest, some = samples_of(coarse_board, 6)
    _, more = samples_of(coarse_board)
    first = more.press < 6
    assert rest.shape == (120, 160, 3)
    assert np.array_equal(some.picture, more.picture[first])
    assert np.array_equal(some.displacement, more.displacement[first])
    moved_um = 1e6 * np.abs(more.displacement).max(axis=(1, 2, 3))
    changed = np.abs(more.picture.astype(int) - rest).max(axis=(1, 2, 3)) > 20
    deep, free = moved_um > 250, moved_um < 1
    assert min(deep.sum(), free.sum()) >= N_PRESSES
    assert changed[deep].all()  # a picture stands beside its own displacement
    assert not changed[free].any()


def test_kept_presses_are_taken_and_broken_ones_made_again(coarse_board, monkeypatch):
    _, before = samples_of(coarse_board)
    cut = sorted((presses.cache_folder().parent / "train").rglob("presses-*.npz"))
    cut[0].write_bytes(cut[0].read_bytes()[:1000])
    made = []
    simulated = presses._simulated
    monkeypatch.setattr(presses, "_simulated", lambda *a: made.append(a[-1]) or simulated(*a))
    _, after = samples_of(coarse_board)
    assert made == [0]
    assert np.array_equal(before.picture, after.picture)


def test_a_file_that_is_no_network_is_refused(tmp_path):
    board = find_board("gelslim")
    rest = np.zeros((240, 320, 3), np.uint8)
    with pytest.raises(InputError, match="no such network"):
        DisplacementNetwork(tmp_path / "none.onnx", board, rest)
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(InputError, match="export it again"):
        DisplacementNetwork(tmp_path / "text.onnx", board, rest)


def trainer_of(board, folder, n_passes=N_PASSES):
    from ruffini.train.fit import Plan, Trainer

    return Trainer(board, Plan(N_PRESSES, n_passes, SEED), *samples_of(board), folder)


@pytest.fixture
def one_thread():
    torch = pytest.importorskip("torch", reason=NO_TORCH)
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield torch
    torch.set_num_threads(before)


def test_nodes_read_the_features_where_the_camera_sees_them(one_thread):
    from ruffini.train.network import FEATURE_STEP, node_weights

    board = find_board("gelslim")
    rows, columns = node_weights(board, (30, 40), 2)
    # Node 15 of 31 is on the axis, at pixel 159.5: pixel 79.5 of the half picture. Node 20: 3333 um, 50 pixels more.
    center, right = (np.arange(40) * FEATURE_STEP @ columns)[[15, 20]]
    assert center == pytest.approx(79.5)
    assert right == pytest.approx(79.5 + 25)
    assert (np.arange(30) * FEATURE_STEP @ rows.T)[12] == pytest.approx(59.5)
    assert columns.sum(axis=0) == pytest.approx(np.ones(31))


def test_a_run_that_was_cut_ends_with_the_same_weights(coarse_board, tmp_path, one_thread):
    whole = trainer_of(coarse_board, tmp_path / "whole")
    passes = list(whole.run())
    assert passes[-1].loss < 0.8 * passes[0].loss  # it learns

    cut = trainer_of(coarse_board, tmp_path / "cut")
    next(run := cut.run())
    run.close()
    again = trainer_of(coarse_board, tmp_path / "cut")
    assert len(again.passes) == 1
    rest_of_it = list(again.run())
    assert again.passes == whole.passes
    assert rest_of_it == passes[1:]
    for a, b in zip(whole.net.state_dict().values(), again.net.state_dict().values(), strict=True):
        assert one_thread.equal(a, b)

    with pytest.raises(InputError, match="another board, seed, number of presses or passes"):
        trainer_of(coarse_board, tmp_path / "cut", n_passes=N_PASSES + 1)
    (tmp_path / "cut" / "checkpoint.pt").write_bytes(b"no checkpoint")
    with pytest.raises(InputError, match="no checkpoint of a training"):
        trainer_of(coarse_board, tmp_path / "cut")


def test_opencv_runs_what_was_trained(coarse_board, tmp_path, one_thread):
    pytest.importorskip("onnxscript", reason=NO_TORCH)
    from ruffini.train.export import export

    trainer = trainer_of(coarse_board, tmp_path, n_passes=1)
    list(trainer.run())
    file = export(trainer.net, (120, 160), tmp_path)
    rng = np.random.default_rng(1)
    rest, frame = rng.integers(0, 256, (2, 240, 320, 3)).astype(np.uint8)
    found = DisplacementNetwork(file, coarse_board, rest).displacement_m(frame)
    both = np.concatenate([np.moveaxis(presses.shrunk(p, 2), -1, 0) for p in (frame, rest)]).astype(np.float32)
    with one_thread.no_grad():
        expected = trainer.net(one_thread.from_numpy(both)[None])[0].numpy()
    assert found.shape == (25, 31, 3)
    assert np.abs(expected).max() > 1
    assert np.moveaxis(found, -1, 0) * 1e6 == pytest.approx(expected, abs=1e-2)

    other = find_board("ftouch")
    empty = np.zeros((other.camera.height_px, other.camera.width_px, 3), np.uint8)
    with pytest.raises(InputError, match="train its own"):
        DisplacementNetwork(file, other, empty)
