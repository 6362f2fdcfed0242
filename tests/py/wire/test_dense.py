"""Node values on the wire against golden bytes, round trips, and hostile bytes."""

from __future__ import annotations

import contextlib

import numpy as np
import pytest
from golden import read_vectors
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from ruffini.errors import InputError
from ruffini.wire.dense import MAX_VALUES, decode_dense, encode_dense

DENSE = read_vectors("dense.txt")


@pytest.mark.parametrize("vector", DENSE, ids=[v[0] for v in DENSE])
def test_golden_bytes(vector: list[str]) -> None:
    _, codec, nodes, components, data, values = vector
    args = (int(codec), int(nodes), 1, int(components), bytes.fromhex(data))
    if values == "error":
        with pytest.raises(InputError, match="dense data"):
            decode_dense(*args)
        return
    wanted = np.array([int(v) for v in values.split(",")], np.int64)
    np.testing.assert_array_equal(decode_dense(*args).ravel(), wanted)
    assert encode_dense(wanted.astype(np.int32), int(components)) == (int(codec), bytes.fromhex(data))


@given(hnp.arrays(np.int32, st.tuples(st.integers(1, 60), st.integers(1, 3))))
def test_round_trip(nodes: np.ndarray) -> None:
    codec, data = encode_dense(nodes, nodes.shape[1])
    np.testing.assert_array_equal(decode_dense(codec, len(nodes), 1, nodes.shape[1], data)[0], nodes)


@given(hnp.arrays(np.int32, st.tuples(st.integers(1, 40), st.integers(1, 3))), st.data())
def test_spoilt_bytes_are_an_error_or_values_of_the_same_shape(nodes: np.ndarray, data: st.DataObject) -> None:
    codec, packed = encode_dense(nodes, nodes.shape[1])
    spoilt = bytearray(packed)
    at = data.draw(st.integers(0, len(spoilt) - 1))
    spoilt[at : at + 1] = data.draw(st.binary(max_size=3))
    with contextlib.suppress(InputError):
        assert decode_dense(codec, len(nodes), 1, nodes.shape[1], bytes(spoilt)).shape == (1, *nodes.shape)


@given(st.integers(0, 3), st.integers(0, 2**32), st.integers(0, 100), st.integers(0, 4), st.binary(max_size=300))
def test_hostile_bytes_are_an_error_or_bounded(codec: int, n_x: int, n_y: int, components: int, data: bytes) -> None:
    with contextlib.suppress(InputError):
        assert decode_dense(codec, n_x, n_y, components, data).size <= MAX_VALUES


def test_a_mark_of_a_node_that_does_not_exist_is_refused() -> None:
    one_value = b"\x02" + b"\x02" + bytes(7)
    assert decode_dense(1, 3, 1, 1, b"\x01" + one_value).ravel().tolist() == [1, 0, 0]
    with pytest.raises(InputError, match="nodes that do not exist"):
        decode_dense(1, 3, 1, 1, b"\x11" + one_value)
