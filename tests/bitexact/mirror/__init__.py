"""The data path once more, in numpy integers, written from the formulas in the stages' headers.

It imports neither the core nor ctypes: two independent writings of the same arithmetic must agree bit
for bit. Everything is int64; names and scales are those of firmware/base/fixed.h.
"""
