"""Node values: zigzag, blocks of 32, bit packing; sparse with a bitmap of active nodes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError

BLOCK = 32
LANES = np.arange(BLOCK)
PACKED, SPARSE = 0, 1
MAX_VALUES = 1 << 22  # 4 million: more than any board; nothing from the wire allocates beyond it


def _unpack(data: memoryview, n_values: int) -> tuple[npt.NDArray[np.int32], int]:
    """`n_values` values and the number of bytes that they took."""
    n_blocks = -(-n_values // BLOCK)
    widths, starts = np.empty(n_blocks, np.int64), np.empty(n_blocks, np.int64)
    n_bytes, at = len(data), 0
    for block in range(n_blocks):
        if at >= n_bytes:
            raise InputError("dense data is truncated")
        width = data[at]
        if width > 32 or at + 1 + 4 * width > n_bytes:
            raise InputError(f"dense data has a block of width {width} that does not fit")
        widths[block], starts[block] = width, 8 * at + 8
        at += 1 + 4 * width
    # Each value's bits lie within the eight bytes that begin with its first bit's byte.
    padded = bytes(data[:at]) + bytes(8)
    windows: npt.NDArray[np.uint64] = np.ndarray((at + 1,), "<u8", padded, 0, (1,))
    bit = starts[:, None] + LANES * widths[:, None]
    masks = (np.uint64(1) << widths.astype(np.uint64)) - np.uint64(1)
    values = (windows[bit >> 3] >> (bit & 7).astype(np.uint64)) & masks[:, None]
    values = values.ravel()[:n_values].astype(np.uint32)
    return ((values >> 1) ^ -(values & 1)).view(np.int32), at


def decode_dense(codec: int, n_x: int, n_y: int, n_components: int, data: bytes) -> npt.NDArray[np.int32]:
    """Values of a Dense message, (n_y, n_x, n_components) int32.

    Raises
    ------
    InputError
        The data does not hold exactly what the sizes say.
    """
    n_nodes = n_x * n_y
    if not 0 < n_nodes * n_components <= MAX_VALUES:
        raise InputError(f"dense data of {n_x} x {n_y} x {n_components} values makes no sense")
    view = memoryview(data)
    if codec == PACKED:
        values, used = _unpack(view, n_nodes * n_components)
    elif codec == SPARSE:
        n_bitmap = -(-n_nodes // 8)
        if len(view) < n_bitmap:
            raise InputError("dense data is shorter than its bitmap")
        bits = np.unpackbits(np.frombuffer(view[:n_bitmap], np.uint8), bitorder="little")
        if bits[n_nodes:].any():
            raise InputError("dense data marks nodes that do not exist")
        active = bits[:n_nodes].astype(bool)
        packed, used = _unpack(view[n_bitmap:], int(active.sum()) * n_components)
        values = np.zeros((n_nodes, n_components), np.int32)
        values[active] = packed.reshape(-1, n_components)
        used += n_bitmap
    else:
        raise InputError(f"dense data in unknown codec {codec}: update the host tools")
    if used != len(view):
        raise InputError(f"dense data has {len(view) - used} bytes too many")
    return values.reshape(n_y, n_x, n_components)


def encode_dense(values: npt.NDArray[np.integer], n_components: int) -> tuple[int, bytes]:
    """Codec and bytes of node values, (..., n_components); sparse where at least an eighth of the nodes is zero."""
    nodes = np.asarray(values, np.int32).reshape(-1, n_components)
    active = nodes.any(axis=1)
    if int(active.sum()) * 8 >= len(nodes) * 7:
        return PACKED, _pack(nodes.ravel())
    bitmap = np.packbits(active, bitorder="little").tobytes()
    return SPARSE, bitmap + _pack(nodes[active].ravel())


def _pack(values: npt.NDArray[np.int32]) -> bytes:
    zigzag = ((values.astype(np.int64) << 1) ^ (values.astype(np.int64) >> 31)) & 0xFFFFFFFF
    out = bytearray()
    for start in range(0, len(zigzag), BLOCK):
        block = [int(v) for v in zigzag[start : start + BLOCK]]
        width = max(v.bit_length() for v in block)
        packed = sum(v << (i * width) for i, v in enumerate(block))
        out += bytes([width]) + packed.to_bytes(4 * width, "little")
    return bytes(out)
