"""Printed markers of several views side by side in one frame: each view is followed for itself."""

from __future__ import annotations

import copy

import numpy as np
import numpy.typing as npt

from mirror.board import Board
from mirror.dot_templates import DotTemplates
from mirror.dots import detect_dots
from mirror.fixed import I64
from mirror.markers import DX, DY, Dots, Lattice, X


class ViewMarkers:
    """`rows` (views * markers, 6) as of mirror.markers, in the frame's pixels; `quality` (views * markers,)."""

    def __init__(self, board: Board, rest_grey: I64, rest: I64) -> None:
        self.board, n_views = board, board["markers"]["n_y"]
        one = copy.deepcopy(board)
        one["camera"]["width_px"] //= n_views
        one["markers"] |= {"n_y": 1, "layout": "scattered"}
        self.width_q16 = one["camera"]["width_px"] << 16
        self.views = [Lattice(one) for _ in range(n_views)]
        self.n_found = sum(view.learn(dots) for view, dots in zip(self.views, self._shared(rest_grey), strict=True))
        self.templates = DotTemplates(board, rest, self.rows)

    @property
    def rows(self) -> I64:
        """Of all views."""
        parts = [view.rows.copy() for view in self.views]
        for i, part in enumerate(parts):
            part[:, X] += i * self.width_q16
        return np.concatenate(parts)

    @property
    def quality(self) -> I64:
        return np.concatenate([view.quality for view in self.views])

    def track(self, grey: I64, frame: npt.NDArray[np.uint8]) -> int:
        """Follow one frame; number of markers lost that rest had."""
        for view, dots in zip(self.views, self._shared(grey), strict=True):
            view.assign(dots)
        rows = self.rows
        error2 = self.templates.refine(frame, rows)
        n, n_lost = len(self.views[0].rows), 0
        for i, view in enumerate(self.views):
            own = slice(i * n, (i + 1) * n)
            view.rows[:, [DX, DY]] = rows[own][:, [DX, DY]]
            n_lost += view.finish(error2[own])
        return n_lost

    def _shared(self, grey: I64) -> list[Dots]:
        """Each dot to the view that it lies in."""
        dots, out = detect_dots(self.board, grey), []
        for i in range(len(self.views)):
            left = i * self.width_q16
            own = dots[(dots[:, 0] >= left) & (dots[:, 0] < left + self.width_q16)].copy()
            own[:, 0] -= left
            out.append(own)
        return out
