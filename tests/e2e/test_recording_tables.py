"""`ruffini export`: a recording as CSV, HDF5, NPZ and Parquet."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
from test_bad_input import is_one_sentence, run_host
from test_recordings import record
from tiny_sensor import N_FRAMES, Sensor
from told_sensor import ToldSensor, info_of, told_field

from ruffini.api import SensorFrame
from ruffini.boards import find_board
from ruffini.device import Connection
from ruffini.errors import InputError
from ruffini.record import Recording, record_stream
from ruffini.record.export import CELLS
from ruffini.record.export import export as write_table
from ruffini.record.plot import plot as write_page


@pytest.fixture(scope="module")
def run(sensor: Sensor, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(sensor, tmp_path_factory.mktemp("exported"))


@pytest.fixture(scope="module")
def frames(run: Path) -> list[SensorFrame]:
    return list(Recording(run).frames())


def export(run: Path, out: Path, kind: str) -> dict[str, object]:
    code, said, text = run_host("export", str(run), "--format", kind, "--out", str(out), "--json")
    assert code == 0, text
    result = json.loads(said)
    assert isinstance(result, dict)
    return result


def test_csv(run: Path, frames: list[SensorFrame], tmp_path: Path) -> None:
    assert export(run, tmp_path / "a.csv", "csv")["frames"] == N_FRAMES
    with (tmp_path / "a.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == N_FRAMES
    assert rows[0]["force_z_n"] == "", "no number where there is none"
    assert rows[0]["flags"] == "FLAG_NO_REFERENCE"
    assert rows[0]["n_missed"] == ""
    assert int(rows[0]["host_utc_ns"]) > 1e18
    last, wrench = rows[-1], frames[-1].wrench
    assert wrench is not None
    assert [float(last[f"force_{a}_n"]) for a in "xyz"] == wrench.force.tolist()
    assert [float(last[f"torque_{a}_nm"]) for a in "xyz"] == wrench.torque.tolist()
    assert (last["is_simulated"], last["is_replay"], last["is_stale"], last["n_contacts"]) == ("1", "1", "0", "1")
    assert last["validity_force_z"] == "1"


@pytest.mark.parametrize("kind", ["npz", "hdf5"])
def test_arrays_with_fields(run: Path, frames: list[SensorFrame], tmp_path: Path, kind: str) -> None:
    said = export(run, tmp_path / f"a.{kind}", kind)
    assert (said["frames"], said["fields"]) == (N_FRAMES, N_FRAMES)
    if kind == "npz":
        arrays = dict(np.load(tmp_path / "a.npz"))
        assert arrays["serial"] == "0001"
        assert arrays["flags"][0] == "FLAG_NO_REFERENCE"
    else:
        with h5py.File(tmp_path / "a.hdf5") as file:
            arrays = {name: np.array(values) for name, values in file.items()}
            assert file.attrs["serial"] == "0001"
            assert file["flags"].asstr()[0] == "FLAG_NO_REFERENCE"
    for i, frame in enumerate(frames):
        assert frame.field is not None
        assert frame.field.displacement is not None
        np.testing.assert_array_equal(arrays["field_force_n"][i], frame.field.force.astype("f4"))
        np.testing.assert_array_equal(arrays["field_displacement_m"][i], frame.field.displacement.astype("f4"))
    assert np.isnan(arrays["force_n"][0]).all()
    assert arrays["node_place_m"].shape == (*arrays["field_force_n"].shape[1:3], 2)
    assert arrays["has_field"].all()


def test_parquet(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Column by column what is in the NPZ, in more than one block."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow, of the extras [parquet] and [dev]")
    monkeypatch.setattr("ruffini.record.export.BLOCK", 16)
    recording = Recording(run)
    assert write_table(recording, tmp_path / "a.parquet", "parquet")["frames"] == N_FRAMES
    write_table(recording, tmp_path / "a.npz", "npz")
    table, arrays = parquet.read_table(tmp_path / "a.parquet"), dict(np.load(tmp_path / "a.npz"))
    single = {name for name, values in arrays.items() if values.shape == (N_FRAMES,) and name != "has_field"}
    cells = {cell: (name, i) for name, each in CELLS.items() for i, cell in enumerate(each)}
    assert len(single) > 8
    assert set(table.column_names) == single | cells.keys()
    for name in table.column_names:
        array, i = cells.get(name, (name, None))
        want = arrays[array] if i is None else arrays[array][:, i]
        np.testing.assert_array_equal(np.array(table[name].to_pylist()), want, err_msg=name)
    assert -table["force_z_n"][-1].as_py() > 0.1
    assert table["flags"][0].as_py() == "FLAG_NO_REFERENCE"
    assert table.schema.metadata[b"serial"] == b"0001"
    assert table.schema.metadata[b"board"] == b"tiny"


def test_parquet_by_its_verb(run: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="needs pyarrow, of the extras [parquet] and [dev]")
    assert export(run, tmp_path / "a.parquet", "parquet")["frames"] == N_FRAMES


def test_without_pyarrow_it_says_what_to_install(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match=r"pip install 'pyarrow>=15'") as said:
        write_table(Recording(run), tmp_path / "a.parquet", "parquet")
    assert "\n" not in str(said.value)
    assert list(tmp_path.iterdir()) == []


def test_of_a_device_with_two_sensors_one_is_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    board, path = find_board("gelslim"), tmp_path / "two.mcap"
    infos = [info_of(board, sensor, (20, 16)) for sensor in (0, 1)]
    monkeypatch.setattr("ruffini.record.mcap_file.SILENCE_S", 0.5)  # the recording ends then
    with ToldSensor(infos, told_field(20, 16)) as told, Connection(told.port) as host:
        told.stop_after = 12
        record_stream(host, path)
    recording = Recording(path)
    code, _, text = run_host("export", str(path))
    assert (code, is_one_sentence(text)) == (2, True)
    assert "has sensors 0, 1: choose one with --sensor" in text
    with pytest.raises(InputError, match="has no sensor 2: it has 0, 1"):
        write_table(recording, tmp_path / "two.npz", "npz", 2)
    assert write_table(recording, tmp_path / "two.npz", "npz", 1) == {"frames": 12, "fields": 12}
    arrays = np.load(tmp_path / "two.npz")
    assert arrays["frame"].tolist() == list(range(12))
    np.testing.assert_allclose(arrays["field_force_n"].sum(axis=(1, 2)), arrays["force_n"], atol=1e-6)
    assert write_page(recording, tmp_path / "two.html", 0)["frames"] == 12
