"""Judging on anybody's data: what the device computes against a truth that it did not make."""
