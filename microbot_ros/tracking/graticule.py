"""Pixel size and angle from a picture of evenly spaced lines: stage micrometer, grating."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.errors import InputError

_LEAST_LINES = 3
"""Choice: periods across a part of the picture; fewer look like uneven light."""

_STANDS_OUT = 15.0
"""Choice: peak of the spectrum over its median; noise alone reaches 5."""

_FAINTEST = 0.3
"""Choice: grey levels below which lines are lost in rounding."""

_FUNDAMENTAL = 0.5
"""Choice: relative height of a peak at a fraction of the frequency that is the fundamental."""

_EVEN = 0.03
"""Choice: relative difference of the period over the field up to which lines count as even."""


@dataclass(frozen=True)
class Graticule:
    """Lines in a picture.

    `period_px` across them, and `angle` [rad] of their normal in the image, from x towards y, in
    (−π/2, π/2]. `period_std_px` and `angle_std` come from the differences between the quarters of
    the picture, distortion included.
    """

    period_px: float
    period_std_px: float
    angle: float
    angle_std: float


def measure_graticule(image: np.ndarray, source: str) -> Graticule:
    """Measure the strongest set of parallel lines in an `image` (H, W).

    The period is the peak of the Fourier spectrum, interpolated; that of the whole picture is the
    start for each quarter. Raises InputError naming `source` if nothing repeats, or not evenly.

    Parameters
    ----------
    image : ndarray, shape (H, W)
        The picture.
    source : str
        Name of the picture, for messages.

    Returns
    -------
    Graticule
        Period and angle of the lines.
    """
    flat = _flattened(image)
    whole = _refined(flat, _peak(flat, source))
    height, width = image.shape
    parts = [_flattened(image[rows, columns]) for rows in _halves(height)
             for columns in _halves(width)]
    found = np.array([_refined(part, whole) for part in parts])
    period, angle = 1 / np.hypot(*found.T), math.atan2(whole[1], whole[0])
    # A normal and its opposite are equivalent.
    turned = np.angle(np.exp(2j * (np.arctan2(found[:, 1], found[:, 0]) - angle))) / 2
    if np.ptp(period) > _EVEN * period.mean():
        raise InputError(source, 'expected evenly spaced lines over the whole picture; their '
                         f'spacing goes from {period.min():.2f} to {period.max():.2f} px')
    return Graticule(
        1 / math.hypot(*whole), float(period.std(ddof=1) / 2), angle,
        float(turned.std(ddof=1) / 2))


def _flattened(image: np.ndarray) -> np.ndarray:
    """Return the picture without its illumination, faded out towards the edges."""
    height, width = image.shape
    y, x = np.mgrid[-1:1:height * 1j, -1:1:width * 1j]
    terms = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1).reshape(-1, 6)
    values = image.astype(float).ravel()
    values = values - terms @ np.linalg.lstsq(terms, values, rcond=None)[0]
    window: np.ndarray = np.hanning(height)[:, None] * np.hanning(width)
    return values.reshape(height, width) * window


def _halves(length: int) -> tuple[slice, slice]:
    return slice(0, length // 2), slice(length // 2, length)


def _peak(flat: np.ndarray, source: str) -> np.ndarray:
    """Return the spatial frequency (2,) [1/px] of the lines, to the resolution of the picture."""
    height, width = flat.shape
    spectrum = np.abs(np.fft.rfft2(flat))
    fy, fx = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None, :]
    least = 2 * _LEAST_LINES / min(height, width)
    spectrum = np.where(np.hypot(fx, fy) >= least, spectrum, 0.0)
    row, column = np.unravel_index(np.argmax(spectrum), spectrum.shape)
    # An amplitude a at every pixel makes a peak of a/8 per pixel under this window.
    least_peak = max(_STANDS_OUT * float(np.median(spectrum)), _FAINTEST / 8 * flat.size)
    if not spectrum[row, column] > least_peak:
        raise InputError(source, 'expected a picture of evenly spaced lines; nothing in it '
                         'repeats')
    strongest = np.array([fx[0, column], fy[row, 0]])
    for part in (4, 3, 2):
        lower = strongest / part
        if math.hypot(*lower) >= least:
            nearby = np.hypot(fx - lower[0], fy - lower[1]) < 1.5 / min(height, width)
            if spectrum[nearby].max(initial=0) > _FUNDAMENTAL * spectrum[row, column]:
                return lower
    return strongest


def _refined(flat: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return the frequency (2,) at the top of the peak near `start`."""
    from scipy.optimize import minimize

    height, width = flat.shape
    x, y = np.arange(width), np.arange(height)
    resolution = 1 / np.array([width, height])

    def power(offset: np.ndarray) -> float:
        fx, fy = start + offset * resolution
        wave = np.exp(-2j * np.pi * fy * y) @ flat @ np.exp(-2j * np.pi * fx * x)
        return -float(abs(wave))

    # Scaled to a value of order one, with steps of a sample of the spectrum.
    scale = -power(np.zeros(2)) or 1.0
    best = minimize(lambda offset: power(offset) / scale, np.zeros(2), method='Nelder-Mead',
                    options={'xatol': 1e-4, 'fatol': 1e-9, 'initial_simplex': [
                        [0, 0], [0.5, 0], [0, 0.5]]})
    found = start + best.x * resolution
    return np.asarray(-found if found[0] < 0 or (found[0] == 0 and found[1] < 0) else found)
