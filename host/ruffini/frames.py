"""Frames of a recording: a video file, or a folder of images as the replay camera reads it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ruffini.errors import InputError
from ruffini.files import readable

LEAST_READ = 0.9  # of the frames that a video claims; some containers only estimate their number
ENDINGS = (".png", ".jpg", ".jpeg", ".bmp", ".ppm")


class Frames:
    """A sized iterable of (h, w, 3) uint8 images, B G R."""

    def __init__(self, path: Path) -> None:
        import cv2

        self.path = path
        self._files: list[Path] = []
        if path.is_dir():
            self._files = image_files(path / "frames" if (path / "frames").is_dir() else path)
            self._count = len(self._files)
            return
        if not path.is_file():
            raise InputError(f"{path}: no such recording")
        video = cv2.VideoCapture(str(path))
        self._count = int(video.get(cv2.CAP_PROP_FRAME_COUNT)) if video.isOpened() else 0
        if self._count <= 0:
            raise InputError(f"{path}: cannot be read as a video: is the file whole?")

    def __len__(self) -> int:
        return self._count

    def __iter__(self) -> Iterator[npt.NDArray[np.uint8]]:
        import cv2

        if self._files:
            yield from (read_image(p) for p in self._files)
            return
        video = cv2.VideoCapture(str(self.path))
        n = 0
        while True:
            ok, frame = video.read()
            if not ok:
                break
            n += 1
            yield np.asarray(frame, dtype=np.uint8)
        if n < LEAST_READ * self._count:
            raise InputError(f"{self.path}: ends after {n} of {self._count} frames: is the file whole?")


def image_files(folder: Path) -> list[Path]:
    """Images of a folder by name, at least one."""
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder of images")
    files = sorted(p for p in folder.iterdir() if p.suffix.lower() in ENDINGS)
    if not files:
        raise InputError(f"{folder} holds no PNG or JPEG images")
    return files


def read_image(path: Path) -> npt.NDArray[np.uint8]:
    """One image, (h, w, 3) uint8, B G R."""
    import cv2

    image = cv2.imread(str(readable(path)), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)  # as the daemon
    if image is None:
        raise InputError(f"cannot read {path} as an image: is it there, and a PNG or JPEG?")
    return np.asarray(image, dtype=np.uint8)


def read_frames(path: Path) -> Frames:
    """Open a recording. Raises InputError where there is none."""
    return Frames(path)
