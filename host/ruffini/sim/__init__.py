"""The digital twin: a pad, an indenter and a camera, independent of the estimators.

Nothing here imports `ruffini.fem`, `ruffini.core` or `ruffini.calibrate`; the pad is discretised with
another element on a finer grid, so estimating its forces is no inverse crime.
"""
