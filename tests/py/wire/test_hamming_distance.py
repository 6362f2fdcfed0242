"""What proto/README.md says of the CRC's Hamming distance, computed.

An error pattern goes unseen when its polynomial is a multiple of the CRC's. Patterns with an odd number of
bits cannot be (x + 1 divides the CRC); what is left are two and four bits.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

POLYNOMIAL = 0x1EDC6F41  # CRC-32C, highest power first, without x^32
CRC_BITS = 32


def residues(n_bits: int) -> npt.NDArray[np.uint32]:
    """x^0, x^1, ... modulo the polynomial."""
    out = np.empty(n_bits, np.uint32)
    value = 1
    for i in range(n_bits):
        out[i] = value
        value = (value << 1 & 0xFFFFFFFF) ^ (POLYNOMIAL if value >> 31 else 0)
    return out


def has_unseen_pattern_of_four(n_bits: int) -> bool:
    """Is 1 + x^i = x^j + x^k for some 0 < i, j, k < n_bits? Every pattern can be shifted to begin at x^0."""
    x = residues(n_bits)
    pairs_with_one = np.sort(x[0] ^ x[1:])
    for j in range(1, n_bits - 1):
        others = x[j] ^ x[j + 1 :]
        at = np.searchsorted(pairs_with_one, others) % len(pairs_with_one)
        if (pairs_with_one[at] == others).any():
            return True
    return False


def test_every_odd_number_of_bits_is_seen() -> None:
    assert (POLYNOMIAL.bit_count() + 1) % 2 == 0  # divisible by x + 1


def test_every_pair_of_bits_of_the_largest_frame_is_seen() -> None:
    x = residues(8 * (12 + 4048) + CRC_BITS)
    assert len(np.unique(x)) == len(x)


def test_four_bits_are_seen_up_to_5243_bits_and_not_beyond() -> None:
    assert not has_unseen_pattern_of_four(5_243 + CRC_BITS)
    assert has_unseen_pattern_of_four(5_244 + CRC_BITS)
