"""How often a damaged frame is taken for a good one: the calculation behind proto/README.md, printed.

The exhaustive part is tests/cpp/link/line_errors_test.cpp: on the largest frame every one and two flipped bits, every
burst of up to 32 bits and every change of one byte is seen. What is left goes unseen one time in 2^32.
"""

from __future__ import annotations

import sys

from ruffini.wire.damage import INTERVAL_S
from ruffini.wire.framing import MAX_FRAME_BYTES

WANTED_PER_H = 4e-9  # SIL 2 in the manner of IEC 61784-3 and OPC UA Safety
UNSEEN = 2.0**-32  # of the damage that the CRC does not see for certain
# From line_errors_test: 390 of 32,600 bits of the largest frame of noise change what COBS means. One of them alone was
# never unseen on the frames tried, but whether it is depends on the payload: counted here as any other damage.
STRUCTURAL_PART = 390 / 32_600
FRAMES_PER_S = 120 * 6  # every message about every frame at 120 Hz, all of the largest size


def believed_per_h() -> float:
    """Wrong frames an hour at most, before the host says that the line is bad, whatever damages it."""
    return 3600 / INTERVAL_S * UNSEEN


def at_bit_error_rate(rate: float) -> float:
    """Wrong frames an hour where single bits flip independently."""
    n_bits = 8 * MAX_FRAME_BYTES
    one = n_bits * rate * STRUCTURAL_PART  # two without a bit of the structure are seen for certain
    four = (n_bits * rate) ** 4 / 24  # three are seen, too
    return 3600 * FRAMES_PER_S * (one + four) * UNSEEN


def main() -> int:
    print(f"any damage, two frames in {INTERVAL_S:.0f} s are said:  {believed_per_h():.1e} an hour")
    print(f"single bits flipped, {FRAMES_PER_S} largest frames/s:")
    for rate in (1e-12, 1e-10, 1e-9, 1e-8):
        print(f"  {rate:.0e} of them  {at_bit_error_rate(rate):.1e} an hour")
    print(f"wanted:  {WANTED_PER_H:.0e} an hour")
    return int(max(believed_per_h(), at_bit_error_rate(1e-12)) > WANTED_PER_H)


if __name__ == "__main__":
    sys.exit(main())
