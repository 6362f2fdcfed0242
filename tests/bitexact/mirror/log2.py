"""Logarithm of an integer (firmware/base/log2.h)."""

from __future__ import annotations


def log2_q16(x: int) -> int:
    """Rounded down, bit by bit, by squares of the mantissa."""
    whole = x.bit_length() - 1
    mantissa = x >> (whole - 30) if whole > 30 else x << (30 - whole)
    out = whole
    for _ in range(16):
        mantissa = mantissa * mantissa >> 30
        above = mantissa >> 31
        mantissa >>= above
        out = 2 * out + above
    return out
