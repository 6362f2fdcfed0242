"""What a frame itself shows to be wrong, in words: flags of ruffini.proto that no calibration mends."""

from __future__ import annotations

FAULTS = {
    8: "markers lost",
    64: "dark",
    128: "overexposed",
    1024: "changed light",
    4096: "not the board's pitch",
    32768: "the same picture again",
    65536: "no whole picture",
}


def faults(flags: int) -> list[str]:
    """Words for a FlagBit mask; empty: nothing is wrong with the picture."""
    return [word for bit, word in FAULTS.items() if flags & bit]


def count_faults(flags: list[int]) -> dict[str, dict[str, int]]:
    """Of a recording: each fault's number of frames, and the first of them."""
    out: dict[str, dict[str, int]] = {}
    for number, mask in enumerate(flags):
        for word in faults(mask):
            row = out.setdefault(word, {"frames": 0, "first": number})
            row["frames"] += 1
    return out


def fault_words(counted: dict[str, dict[str, int]]) -> str:
    """The same as text; empty where nothing is wrong."""
    return ", ".join(f"{word} in {row['frames']} (from frame {row['first']})" for word, row in counted.items())
