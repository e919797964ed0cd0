"""What a scanner adds to anatomy: blur, correlated noise, streaks between dense objects."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.ndimage import gaussian_filter1d

from segmentation.arrays import FloatArray


@dataclass(frozen=True, kw_only=True)
class ScannerSettings:
    """Image quality of the simulated scan.

    Attributes
    ----------
    blur : (float, float, float), mm
        Standard deviation of the point spread along slice, row and column: a standard
        abdominal kernel resolves about 7 line pairs per cm (10 %), which is 0.5 mm.
    noise : float, HU
        Standard deviation in soft tissue; 10 to 15 HU are usual for 1 mm slices of a urography.
    streak : float
        Relative error of the projections through dense parts, from view to view.
    dense : float, HU
        Above it a part throws streaks.
    """

    blur: tuple[float, float, float] = (0.45, 0.5, 0.5)
    noise: float = 12.0
    streak: float = 0.05
    dense: float = 260.0


def scan(
    hu: FloatArray, spacing: tuple[float, float, float], settings: ScannerSettings, *, rng: np.random.Generator
) -> FloatArray:
    """The image a scanner would make of HU on a fine enough grid, (slices, rows, columns).

    Noise is white noise filtered as in filtered backprojection: its spectrum grows with
    the frequency and is cut off by the kernel [1]_. Streaks: an error e(angle) of the
    measured projections of the dense parts is, by the Fourier slice theorem, a factor
    e(angle) on the image's spectrum.

    Parameters
    ----------
    hu : (slices, rows, columns) float array, HU
    spacing : (slice, row, column) distances, mm
    settings : ScannerSettings
    rng : numpy.random.Generator
        Of noise and streaks.

    References
    ----------
    .. [1] Riederer, S. J., Pelc, N. J., Chesler, D. A. (1978). The noise power spectrum in computed
       X-ray tomography. Phys. Med. Biol. 23(3), 446-454.
    """
    image = hu
    for axis, (sigma, step) in enumerate(zip(settings.blur, spacing, strict=True)):
        image = gaussian_filter1d(image, sigma / step, axis=axis, truncate=3.0, mode="nearest")
    slices, rows, columns = image.shape
    fy = fft.fftfreq(rows, spacing[1])[:, None]
    fx = fft.rfftfreq(columns, spacing[2])[None, :]
    frequency = np.hypot(fy, fx)
    # A ramp, as of backprojection, that leaves a little at the lowest frequencies, and a soft kernel: half at 0.35 cycles/mm.
    shaping = (frequency + 0.03) * np.exp(-((frequency / 0.42) ** 2))
    # Unit deviation: the mean square of the filter over the whole spectrum (rfft holds half of it).
    double = np.full(shaping.shape[1], 2.0)
    double[0] = 1.0
    if columns % 2 == 0:
        double[-1] = 1.0
    shaping *= settings.noise / np.sqrt((shaping**2 @ double).sum() / (rows * columns))
    angle = np.mod(np.arctan2(fy, fx), np.pi)
    views = 180
    errors = rng.standard_normal((slices + 2, views))
    errors = 0.25 * errors[:-2] + 0.5 * errors[1:-1] + 0.25 * errors[2:]
    view = angle / np.pi * views
    low = view.astype(int) % views
    share = view - np.floor(view)
    band = 1.0 - np.exp(-((frequency / 0.02) ** 2))  # the mean level of a slice stays
    band = band * np.exp(-((frequency / 0.30) ** 2))
    before = rng.standard_normal((rows, columns))
    here = rng.standard_normal((rows, columns))
    for k in range(slices):
        after = rng.standard_normal((rows, columns))
        white = (0.3 * before + here + 0.3 * after) / np.sqrt(1.0 + 2 * 0.3**2)  # neighbouring slices overlap a little
        before, here = here, after
        error = (1.0 - share) * errors[k][low] + share * errors[k][(low + 1) % views]
        dense = np.clip(image[k] - settings.dense, 0.0, None)
        spectrum = fft.rfft2(white) * shaping + fft.rfft2(dense) * (settings.streak * error * band)
        image[k] += fft.irfft2(spectrum, s=(rows, columns))
    return image
