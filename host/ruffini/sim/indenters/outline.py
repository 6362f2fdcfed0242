"""Outlines of flat-faced indenters as signed distances: negative inside, lengths over the indenter's radius.

The radius is half of the size that names the shape: of the disc's diameter, of a side of triangle and
square, of the width across the flats of hexagon and nut, of the height of H and T.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Outline = Callable[[Array, Array], Array]

RING_HOLE = 0.6  # inner radius over outer
NUT_HOLE = 0.6  # ISO 4032: thread of 6 mm in 10 mm across the flats
BAR = 0.2  # half width of the bars of H and T
# USB 2.0 type A plug, over half of its 12.0 mm: shell 4.5 mm high of 0.3 mm sheet, insert of 1.95 mm
USB_HALF_HEIGHT, USB_SHEET, USB_INSERT = 0.375, 0.05, 0.325


def polygon(corners: npt.ArrayLike) -> Outline:
    """Signed distance to a simple polygon with corners (n, 2)."""
    ends = np.asarray(corners, dtype=float)
    starts = np.roll(ends, 1, axis=0)

    def distance(x: Array, y: Array) -> Array:
        nearest, is_inside = np.full(np.shape(x), np.inf), np.zeros(np.shape(x), dtype=bool)
        for (ax, ay), (bx, by) in zip(starts, ends, strict=True):
            ex, ey = bx - ax, by - ay
            part = np.clip(((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey), 0, 1)
            nearest = np.minimum(nearest, np.hypot(x - ax - part * ex, y - ay - part * ey))
            if ey:  # a ray towards +x crosses this side
                crosses = ((ay > y) != (by > y)) & (x < ax + (y - ay) * ex / ey)
                is_inside ^= crosses
        return np.where(is_inside, -nearest, nearest)

    return distance


def _regular(n: int, inner_radius: float) -> Outline:
    """Regular polygon with one side downwards (y > 0 in the image)."""
    angles = np.pi / 2 + np.pi / n + 2 * np.pi / n * np.arange(n)
    return polygon(inner_radius / np.cos(np.pi / n) * np.column_stack([np.cos(angles), np.sin(angles)]))


def _rectangle(half_x: float, half_y: float) -> Outline:
    return polygon([(-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y)])


def disc(x: Array, y: Array) -> Array:
    """The unit disc."""
    return np.hypot(x, y) - 1


def ring(x: Array, y: Array) -> Array:
    """The unit disc with a round hole."""
    middle, half = (1 + RING_HOLE) / 2, (1 - RING_HOLE) / 2
    return np.abs(np.hypot(x, y) - middle) - half


hexagon = _regular(6, 1.0)
_usb_shell = _rectangle(1.0, USB_HALF_HEIGHT)
_usb_room = _rectangle(1.0 - USB_SHEET, USB_HALF_HEIGHT - USB_SHEET)
# The insert lies on the lower side of the room.
_usb_insert = polygon(
    [(sx * (1 - 2 * USB_SHEET), USB_HALF_HEIGHT - USB_SHEET - up) for sx, up in
     ((-1, USB_INSERT), (1, USB_INSERT), (1, 0.0), (-1, 0.0))]
)  # fmt: skip


def nut(x: Array, y: Array) -> Array:
    """Hexagon with a round hole."""
    return np.maximum(hexagon(x, y), NUT_HOLE - np.hypot(x, y))


def usb_plug(x: Array, y: Array) -> Array:
    """Front face of a plug: sheet all round, and the insert in it."""
    return np.minimum(np.maximum(_usb_shell(x, y), -_usb_room(x, y)), _usb_insert(x, y))


_H = [(-1, -1), (-1 + 2 * BAR, -1), (-1 + 2 * BAR, -BAR), (1 - 2 * BAR, -BAR), (1 - 2 * BAR, -1), (1, -1),
      (1, 1), (1 - 2 * BAR, 1), (1 - 2 * BAR, BAR), (-1 + 2 * BAR, BAR), (-1 + 2 * BAR, 1), (-1, 1)]  # fmt: skip
_T = [(-1, -1), (1, -1), (1, -1 + 2 * BAR), (BAR, -1 + 2 * BAR), (BAR, 1), (-BAR, 1), (-BAR, -1 + 2 * BAR),
      (-1, -1 + 2 * BAR)]  # fmt: skip

OUTLINES: dict[str, Outline] = {
    "flat": disc,
    "triangle": _regular(3, 1 / np.sqrt(3)),
    "square": _rectangle(1.0, 1.0),
    "hexagon": hexagon,
    "ring": ring,
    "h": polygon(_H),
    "t": polygon(_T),
    "nut": nut,
    "usb_plug": usb_plug,
}
