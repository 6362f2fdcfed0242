"""Block floating point on Python's unbounded integers, so that an overflow in the core would show."""

from __future__ import annotations

from mirror.fixed import Saturations

LIMIT = (1 << 31) - 1
WIDE_LIMIT = 1 << 62


def limited(x: int, saturations: Saturations, limit: int = LIMIT) -> int:
    if abs(x) > limit:
        saturations.count += 1
        return limit if x > 0 else -limit
    return x


def shifted(x: int, right: int) -> int:
    if right > 0:
        return 0 if right > 62 else (x + (1 << (right - 1))) >> right
    return max(-WIDE_LIMIT, min(WIDE_LIMIT, x << -right))


def common_shift(values: list[int]) -> int:
    largest = max((abs(v) for v in values), default=0)
    return max((largest + (largest >> 14)).bit_length() - 15, 0)


def to_16(values: list[int], shift: int) -> list[int]:
    return values if shift == 0 else [shifted(v, shift) for v in values]


def in_16_bits(values: list[int]) -> list[int]:
    return to_16(values, common_shift(values))


def squares(values: list[int], shift: int) -> int:
    return sum(v * v for v in to_16(values, shift))


def ratio(numerator: int, denominator: int, exponent: int) -> tuple[int, int]:
    """Mantissa of 24 bits and exponent of numerator / denominator 2^exponent."""
    up = 62 - numerator.bit_length()
    down = max(denominator.bit_length() - 38, 0)
    mantissa = (numerator << up) // (denominator >> down)
    extra = max(mantissa.bit_length() - 24, 0)
    return mantissa >> extra, exponent - up - down + extra


def scaled(value: int, ratio: tuple[int, int], exponent: int) -> int:
    assert abs(value) < 1 << 39
    return shifted(value * ratio[0], -(ratio[1] + exponent))
