"""From light to the picture that arrives: exposure, noise, colour mosaic, dust, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ruffini.sim.optics.charts import Floats
from ruffini.sim.optics.settings import NoiseSettings, SensorSettings, WearSettings

Picture = npt.NDArray[np.uint8]


def dust_map(wear: WearSettings, shape: tuple[int, int], seed: int) -> Floats:
    """What dust on the sensor's glass leaves of the light, (h, w): soft dark spots."""
    rng = np.random.default_rng([seed, 1])
    left = np.ones(shape, dtype=np.float32)
    v, u = np.mgrid[: shape[0], : shape[1]]
    for _ in range(wear.n_dust):
        x, y, size = rng.uniform(0, shape[1]), rng.uniform(0, shape[0]), wear.dust_px * rng.uniform(0.5, 1.5)
        spot = np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * size * size))
        left *= (1 - wear.dust_darkness_1e3 * 1e-3 * spot).astype(np.float32)
    return left


@dataclass
class ImageSensor:
    """Grey levels of light in grey levels."""

    noise: NoiseSettings
    settings: SensorSettings

    def expose(self, light: Floats, rng: np.random.Generator) -> Picture:
        """One picture, (h, w, 3) uint8 B G R, of light (h, w, 3)."""
        picture = self._digitise(light, rng) if self.settings.bayer == "none" else self._mosaic(light, rng)
        return self._compress(picture) if self.settings.jpeg_quality else picture

    def _digitise(self, light: Floats, rng: np.random.Generator) -> Picture:
        sigma = np.float32(self.noise.shot_1e3 * 1e-3) * light
        sigma += np.float32((self.noise.read_1e3 * 1e-3) ** 2)
        noisy = rng.standard_normal(light.shape, dtype=np.float32)
        noisy *= np.sqrt(sigma, out=sigma)
        noisy += light
        return np.asarray(np.clip(np.rint(noisy, out=noisy), 0, 255, out=noisy), dtype=np.uint8)

    def _mosaic(self, light: Floats, rng: np.random.Generator) -> Picture:
        """One colour a pixel, rows R G / G B, then bilinear interpolation of the others."""
        import cv2

        raw = light[:, :, 1].copy()
        raw[::2, ::2], raw[1::2, 1::2] = light[::2, ::2, 2], light[1::2, 1::2, 0]
        # OpenCV names a mosaic by its second row's second and third pixel.
        return np.asarray(cv2.cvtColor(self._digitise(raw, rng), cv2.COLOR_BayerBG2BGR))

    def _compress(self, picture: Picture) -> Picture:
        import cv2

        _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.settings.jpeg_quality])
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), dtype=np.uint8)
