"""Datasets: the same bytes whoever makes them, every sample once, valid whatever interrupts."""

import errno
import fcntl
import hashlib
import os
import signal
from io import BytesIO
from pathlib import Path

import h5py
import numpy as np
import pytest

from ruffini.errors import InputError, RuffiniError
from ruffini.sim.dataset import shard as shards
from ruffini.sim.dataset.make import make_dataset
from ruffini.sim.dataset.plan import Plan
from ruffini.sim.dataset.workers import on_dask
from ruffini.sim.unit import PadError

N, SHARD_SIZE = 7, 2


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.getbasetemp() / "cache"))


def plan(board, **more):
    return Plan.of(board, **{"n": N, "shard_size": SHARD_SIZE, "seed": 5, "error": PadError(), **more})


@pytest.fixture(scope="module")
def serial(coarse_board, tmp_path_factory):
    folder = tmp_path_factory.mktemp("data") / "serial"
    make_dataset(plan(coarse_board), folder)
    return folder


def sums(folder):
    return {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in sorted(folder.glob("*.h5"))}


def indices(folder):
    found = []
    for path in sorted(folder.glob("*.h5")):
        with h5py.File(path) as file:
            found += file["index"][:].tolist()
    return found


def test_samples_carry_their_truth(serial, coarse_board):
    assert indices(serial) == list(range(N))
    with h5py.File(serial / "shard-00001.h5") as file:
        assert file.attrs["simulated"]
        assert file["image"].shape == (2, 240, 320, 3)
        np.testing.assert_allclose(file["force"][:].sum((1, 2)), file["wrench"][:, :3], atol=1e-5)
        assert (file["wrench"][:, 2] < -0.02).all()
        assert (file["pose"][:, 2] >= 0.3e-3).all()
        assert set(file["shape"].asstr()[:]) <= {"sphere", "flat"}
        change = np.abs(file["image"][:].astype(float) - file["reference"][:].mean(axis=0))
        assert (change.max(axis=(1, 2, 3)) > 20).all()
        assert file["force"].attrs["unit"].startswith(b"N:")
        assert Plan.model_validate_json(file.attrs["plan"]) == plan(coarse_board)


def test_card_says_what_it_is_and_names_every_file(serial):
    text = (serial / "README.md").read_text()
    assert "**Simulated**" in text
    for name, digest in sums(serial).items():
        assert f"| {name} | {1 if name == 'shard-00003.h5' else 2} | {digest} |" in text
    with h5py.File(serial / "shard-00000.h5") as file:
        assert all(f"| `{name}` |" in text for name in file)


def test_processes_make_the_same_bytes(coarse_board, serial, tmp_path):
    outcome = make_dataset(plan(coarse_board), tmp_path / "two", n_workers=2)
    assert (outcome.n_made, outcome.n_kept, outcome.n_samples_made) == (4, 0, N)
    assert sums(tmp_path / "two") == sums(serial)


def test_a_run_that_was_stopped_goes_on(coarse_board, serial, tmp_path):
    def stop_after_two(done):
        if done >= 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(plan(coarse_board), tmp_path / "d", progress=stop_after_two)
    assert indices(tmp_path / "d") == [0, 1, 2, 3]
    assert not (tmp_path / "d" / "README.md").exists()
    (tmp_path / "d" / "shard-00001.h5").write_bytes(b"torn")
    outcome = make_dataset(plan(coarse_board), tmp_path / "d")
    assert (outcome.n_made, outcome.n_kept) == (3, 1)
    assert sums(tmp_path / "d") == sums(serial)


def test_full_disk_leaves_valid_shards_and_the_run_goes_on(coarse_board, serial, tmp_path, monkeypatch):
    write_bytes = Path.write_bytes

    def small_disk(path, data):
        if path.name.startswith("shard-00002"):
            write_bytes(path, data[: len(data) // 2])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write_bytes(path, data)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "write_bytes", small_disk)
        with pytest.raises(InputError, match=r"shard-00002\.h5 cannot be written \(No space left.*same command again"):
            make_dataset(plan(coarse_board), tmp_path / "d")
    assert indices(tmp_path / "d") == [0, 1, 2, 3]
    assert not list((tmp_path / "d").glob("*.part"))
    make_dataset(plan(coarse_board), tmp_path / "d")
    assert sums(tmp_path / "d") == sums(serial)


def test_another_plan_or_folder_is_refused(coarse_board, serial, tmp_path):
    with pytest.raises(InputError, match="another seed"):
        make_dataset(plan(coarse_board, seed=6), serial)
    (tmp_path / "mine").write_text("keep")
    with pytest.raises(InputError, match="holds mine and no dataset"):
        make_dataset(plan(coarse_board), tmp_path)
    with pytest.raises(InputError, match="dataset: n: "):
        plan(coarse_board, n=0)


def test_two_runs_do_not_write_the_same_dataset(coarse_board, tmp_path):
    with (tmp_path / ".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another run writes there now"):
            make_dataset(plan(coarse_board), tmp_path)


def test_a_worker_of_another_version_is_refused(coarse_board):
    old = plan(coarse_board).model_copy(update={"version": "0.0.1"})
    with pytest.raises(RuffiniError, match="update the worker"):
        shards.make_shard(old.model_dump_json(), 0)


def test_presses_that_the_solver_gives_up_on_are_drawn_again(coarse_board, monkeypatch):
    held, calls = shards._held, []

    def fails_first(unit, touch):
        calls.append(touch)
        if len(calls) == 1:
            raise RuffiniError("no convergence")
        return held(unit, touch)

    monkeypatch.setattr(shards, "_held", fails_first)
    data = shards.make_shard(plan(coarse_board, n=1).model_dump_json(), 0)
    with h5py.File(BytesIO(data)) as file:
        assert file["attempt"][:].tolist() == [1]
    assert len(calls) == 2


@pytest.fixture(scope="module")
def cluster_of():
    """Makes clusters whose workers are forked by one process that has imported what they need: that takes seconds."""
    distributed = pytest.importorskip("distributed")
    import dask

    with dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"}):
        context = distributed.utils.get_mp_context()
        context.set_forkserver_preload(["distributed", shards.__name__])

        def make(n_workers, folder):
            return distributed.LocalCluster(
                n_workers=n_workers, threads_per_worker=1, processes=True, dashboard_address=None,
                local_directory=str(folder),
            )  # fmt: skip

        yield make


def test_a_killed_dask_worker_loses_nothing_and_doubles_nothing(coarse_board, cluster_of, tmp_path):
    """Two worker processes; one is killed with most shards still to make. What it had is made by the other ones."""
    larger = plan(coarse_board, n=6, shard_size=1)
    distributed = pytest.importorskip("distributed")
    with cluster_of(2, tmp_path / "w") as cluster:
        with distributed.Client(cluster, set_as_default=False) as client:
            workers = list(client.run(os.getpid).values())
        assert len(workers) == 2
        written, victims = [], workers[:1]

        def kill_one(done):
            written.append(done)
            if done > 0.1 and victims:
                os.kill(victims.pop(), signal.SIGKILL)

        outcome = make_dataset(larger, tmp_path / "d", dask=cluster.scheduler_address, progress=kill_one)
    assert not victims
    assert outcome.n_made == 6
    assert written == pytest.approx([i / 6 for i in range(7)])  # at the start, and once for each shard
    assert indices(tmp_path / "d") == list(range(6))
    make_dataset(larger, tmp_path / "here")
    assert sums(tmp_path / "d") == sums(tmp_path / "here")


def test_a_cluster_that_goes_away_leaves_whole_shards(coarse_board, tmp_path):
    distributed = pytest.importorskip("distributed")
    larger = plan(coarse_board, n=6, shard_size=1)
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp://",
        dashboard_address=None,
        local_directory=str(tmp_path / "w"),
    ) as cluster:

        def pull_the_plug(done):
            if done > 0.1:
                cluster.close()

        with pytest.raises(RuffiniError, match="went away: what is written is whole"):
            make_dataset(larger, tmp_path / "d", dask=cluster.scheduler_address, progress=pull_the_plug)
    left = indices(tmp_path / "d")
    assert 1 <= len(left) < 6
    make_dataset(larger, tmp_path / "d")
    assert indices(tmp_path / "d") == list(range(6))


def test_a_scheduler_without_workers_is_one_sentence(coarse_board, monkeypatch):
    distributed = pytest.importorskip("distributed")
    wait = distributed.Client.wait_for_workers
    monkeypatch.setattr(distributed.Client, "wait_for_workers", lambda self, n, timeout: wait(self, n, timeout=0.1))
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(InputError, match="has no workers"),
    ):
        next(on_dask(plan(coarse_board), [0], cluster.scheduler_address))


def test_no_scheduler_is_one_sentence(coarse_board, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("ruffini.workers.CONNECT_TIMEOUT_S", 0.5)
    with pytest.raises(InputError, match=r"no Dask scheduler answers at tcp://127\.0\.0\.1:9"):
        next(on_dask(plan(coarse_board), [0], "tcp://127.0.0.1:9"))
