"""Lens, mounting and dark frame of a camera."""
