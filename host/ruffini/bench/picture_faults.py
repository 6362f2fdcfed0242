"""What can happen to the picture of a camera or of its pad: each fault makes a bad picture of a good one."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from ruffini.sim.optics.conditions import Conditions

Picture = npt.NDArray[np.uint8]
Fault = Callable[[Picture, np.random.Generator], Picture]

# What the twin renders.
CONDITIONS = {
    "lens cap": Conditions(is_capped=True),
    "one lamp off": Conditions(lamps_off=(0,)),
    "exposure x 5": Conditions(exposure=5.0),
    "exposure x 1.3": Conditions(exposure=1.3),
    "exposure x 0.7": Conditions(exposure=0.7),
    "exposure x 0.3": Conditions(exposure=0.3),
    "daylight, 0.1 of the level": Conditions(leak=0.1),
    "daylight, 0.3 of the level": Conditions(leak=0.3),
    "torn gel, radius 2 mm": Conditions(tear_um=(0, 0, 2000)),
}


def _rows(start: float, stop: float, level: int | None) -> Fault:
    """Rows of these shares of the height: a level, or noise."""

    def fault(picture: Picture, rng: np.random.Generator) -> Picture:
        out, n = picture.copy(), len(picture)
        part = out[round(start * n) : max(round(stop * n), round(start * n) + 1)]
        part[:] = rng.integers(0, 256, part.shape, np.uint8) if level is None else level
        return out

    return fault


def _channel_off(picture: Picture, rng: np.random.Generator) -> Picture:
    out = picture.copy()
    out[..., rng.integers(3)] //= 8
    return out


def _column(picture: Picture, rng: np.random.Generator) -> Picture:
    out = picture.copy()
    out[:, rng.integers(out.shape[1])] = 255
    return out


def _hot_pixels(picture: Picture, rng: np.random.Generator) -> Picture:
    out = picture.copy()
    out[rng.random(out.shape[:2]) < 1e-3] = 255
    return out


def _rolled(picture: Picture, _: np.random.Generator) -> Picture:
    return np.roll(picture, len(picture) // 3, axis=0)


def _swapped(picture: Picture, _: np.random.Generator) -> Picture:
    return picture[..., ::-1].copy()


def _blurred(picture: Picture, _: np.random.Generator) -> Picture:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 6), dtype=np.uint8)


def painted(share: float) -> Fault:
    """So much of the picture, in round spots of 3 % of its height, hidden under the colour that is round it."""

    def fault(picture: Picture, rng: np.random.Generator) -> Picture:
        out, (height, width) = picture.copy(), picture.shape[:2]
        radius = max(3, round(0.03 * height))
        plain = cv2.medianBlur(picture, min(255, 4 * radius + 1))
        for _ in range(max(1, round(share * height * width / (np.pi * radius**2)))):
            mask = np.zeros((height, width), np.uint8)
            cv2.circle(mask, (int(rng.integers(width)), int(rng.integers(height))), radius, 1, -1)
            out[mask > 0] = plain[mask > 0]
        return out

    return fault


def moved(shift_px: tuple[float, float] = (0, 0), zoom: float = 1, turn_deg: float = 0) -> Fault:
    """The camera stands elsewhere: the picture about its middle, its border continued."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        height, width = picture.shape[:2]
        way = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), turn_deg, zoom)
        way[:, 2] += np.array(shift_px)
        out = cv2.warpAffine(picture, way, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(out, dtype=np.uint8)

    return fault


def posterised(n_lost: int, *, is_replicated: bool = False) -> Fault:
    """So many low bits are zero, or copies of the high ones."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        kept = (picture >> n_lost) << n_lost
        return np.asarray(kept | (picture >> (8 - n_lost)) if is_replicated else kept, dtype=np.uint8)

    return fault


def compressed(quality: int) -> Fault:
    """Sent as JPEG."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        _is_ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)

    return fault


def toned(gamma: float = 1, black: float = 0) -> Fault:
    """Another curve from light to grey levels: 255 (I / 255)^gamma + black."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        curve = 255 * (np.arange(256) / 255) ** gamma + black
        return np.asarray(np.clip(np.round(curve), 0, 255).astype(np.uint8)[picture])

    return fault


def slipped(start: float, stop: float, columns: int, rows: int = 0) -> Fault:
    """Rows between these shares of the height stand so many columns and rows aside; what comes in is from beside."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        out, n = picture.copy(), len(picture)
        part = slice(round(start * n), round(stop * n))
        out[part] = np.roll(picture, (rows, columns), axis=(0, 1))[part]
        return out

    return fault


def torn(old: Picture, start: float, stop: float, left: float = 0, right: float = 1) -> Fault:
    """A part of the picture, in shares of its height and width, is of an older one."""

    def fault(picture: Picture, _: np.random.Generator) -> Picture:
        out, (height, width) = picture.copy(), picture.shape[:2]
        part = slice(round(start * height), round(stop * height)), slice(round(left * width), round(right * width))
        out[part] = old[part]
        return out

    return fault


PICTURES: dict[str, Fault] = {
    "frozen": lambda picture, _: picture,  # the same one again and again
    "one row black": _rows(0.5, 0.5, 0),
    "ten rows white": _rows(0.3, 0.34, 255),
    "lower half black": _rows(0.5, 1.0, 0),
    "upper half grey": _rows(0.0, 0.5, 128),
    "noise in a tenth": _rows(0.6, 0.7, None),
    "noise": _rows(0.0, 1.0, None),
    "one column white": _column,
    "0.1 % of the pixels hot": _hot_pixels,
    "one colour to an eighth": _channel_off,
    "rolled by a third": _rolled,
    "red and blue swapped": _swapped,
    "out of focus": _blurred,
    "spots on 1 %": painted(0.01),
    "spots on 10 %": painted(0.1),
    "spots on 50 %": painted(0.5),
}


def bad_pictures(name: str, good: Callable[[Conditions | None], Picture], seed: int, n: int) -> list[Picture]:
    """n frames in a row with a fault; `good` renders a frame with noise of its own.

    Raises
    ------
    KeyError
        There is no such fault.
    """
    if name in CONDITIONS:
        return [good(CONDITIONS[name]) for _ in range(n)]
    if name == "frozen":
        return [good(None)] * (n + 1)  # the first one is still good
    # The same rows, spots and pixels in each frame, of which each has its own noise.
    return [PICTURES[name](good(None), np.random.default_rng(seed)) for _ in range(n)]
