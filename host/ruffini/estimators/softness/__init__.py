"""Modulus of a squeezed object, from the dent that it makes in a gel without markers."""
