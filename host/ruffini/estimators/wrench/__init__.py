"""A wrench of image features."""
