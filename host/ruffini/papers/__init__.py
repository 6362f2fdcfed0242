"""The papers' own methods, plainly in float, as references to be measured against.

Each module is one paper: numpy, scipy and OpenCV, equations by their numbers, no cleverness of ours. Nothing that
runs on a board or calibrates one may import them, and they know neither the twin nor our estimators.
"""
