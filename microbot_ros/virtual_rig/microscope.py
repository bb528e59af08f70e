"""Microscope picture of the simulated world: Janus spheres in bright field, 8 bits.

Light is multiplied by the transmission of each object, blurred by its defocus, and counted in
electrons. A polystyrene sphere refracts light out of the aperture near its edge (a dark rim) and
focuses it in the middle (a bright core); the metal on one half absorbs. The sphere swims with the
bare half in front, so the cap points against the heading.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.common import units
from microbot_ros.common.checked import Field, Settings

_NOISE_BANK = 1 << 20  # choice: stored normal deviates, 3 frames; rows start at random places
_GOLDEN = 0.6180339887498949  # golden ratio, for well distributed phases


class MicroscopeSettings(Settings):
    """YAML section `microscope:` of a virtual rig."""

    width_px: int = Field(default=640, ge=64, le=4096, description='picture width')
    height_px: int = Field(default=480, ge=64, le=4096, description='picture height')
    pixel_size_um: float = Field(default=0.45, gt=0, le=10, description='size in the workspace')
    radius_um: float = Field(default=2.3, gt=0, le=50, description='radius of every particle')
    cap_absorption: float = Field(default=0.75, ge=0, le=1, description='light the metal takes')
    blur_px: float = Field(default=0.9, ge=0.6, le=10, description='std of the blur in focus')
    defocus_px: float = Field(default=1.0, ge=0, le=10, description='most that defocus adds')
    focus_period_s: float = Field(default=17.0, gt=0, description='time of rising and sinking')
    brightness: float = Field(default=150.0, gt=0, le=250, description='grey level at the centre')
    vignette: float = Field(default=0.15, ge=0, le=1, description='light lost in the corners')
    slope: float = Field(default=0.06, ge=0, le=1, description='change of light across the width')
    electrons_per_level: float = Field(default=40.0, gt=0, description='of shot noise')
    read_noise: float = Field(default=0.6, ge=0, le=50, description='std [grey levels]')
    specks: int = Field(default=25, ge=0, le=10000, description='small grains stuck in focus')
    smudges: int = Field(default=30, ge=0, le=10000, description='debris stuck out of focus')
    drifting: int = Field(default=6, ge=0, le=1000, description='smudges carried by the fluid')
    drift_um_s: float = Field(default=0.5, ge=0, le=1000, description='how fast they are carried')

    @property
    def pixel_size(self) -> float:
        """Size of a pixel in the workspace [m]."""
        return units.to_si('pixel_size_um', self.pixel_size_um)


class Microscope:
    """Renders the camera's picture by `settings`; `seed` fixes the debris and every frame's noise.

    The workspace origin lies at the picture's centre ((W − 1)/2, (H − 1)/2); the centre of the
    first pixel is (0, 0); y points up in the workspace and down in the picture.

    Parameters
    ----------
    settings : MicroscopeSettings
        Settings of the microscope.
    seed : int
        Seed of debris and noise.
    """

    def __init__(self, settings: MicroscopeSettings, seed: int) -> None:
        self.settings = settings
        self._rng = np.random.default_rng(seed)
        self._noise = self._rng.standard_normal(_NOISE_BANK, dtype=np.float32)
        self._background = self._illumination()
        self._stain()
        shape = (settings.drifting, 2)
        self._drift_start = self._rng.uniform(0, 1, shape)
        self._drift_velocity = self._rng.normal(0, 1, shape) * (
            settings.drift_um_s / settings.pixel_size_um / math.sqrt(2))

    def pixels(self, position: np.ndarray) -> np.ndarray:
        """Return the pixel coordinates (..., 2) of a `position` (..., 2) [m].

        Parameters
        ----------
        position : ndarray, shape (..., 2)
            Positions [m].

        Returns
        -------
        ndarray, shape (..., 2)
            Pixel coordinates.
        """
        s = self.settings
        centre = np.array([(s.width_px - 1) / 2, (s.height_px - 1) / 2])
        return centre + np.asarray(position) * np.array([1, -1]) / s.pixel_size

    def defocus(self, count: int, t: float) -> np.ndarray:
        """Return the defocus (`count`,) of particles at `t` [s], within ±1.

        Parameters
        ----------
        count : int
            Number of particles N.
        t : float
            Time [s].

        Returns
        -------
        ndarray, shape (N,)
            Defocus.
        """
        phase = 2 * np.pi * (t / self.settings.focus_period_s + _GOLDEN * np.arange(count))
        return 0.6 * np.sin(phase) + 0.4 * np.sin(1.618 * phase)

    def expose(self, position: np.ndarray, theta: np.ndarray, t: float) -> np.ndarray:
        """Return the light before the sensor (H, W) float32 [grey levels], without noise.

        `position` (N, 2) [m], `theta` (N,) heading [rad], `t` [s]. Particles out of view or not
        finite are not drawn.

        Parameters
        ----------
        position : ndarray, shape (N, 2)
            Positions [m].
        theta : ndarray, shape (N,)
            Headings [rad].
        t : float
            Time [s].

        Returns
        -------
        ndarray, shape (H, W)
            Light, float32 [grey levels].
        """
        from microbot_ros.virtual_rig.optics import draw_smudge, draw_sphere

        s = self.settings
        light = self._background.copy()
        box = np.array([s.width_px, s.height_px])
        for x, y in np.mod(self._drift_start * box + self._drift_velocity * t, box):
            draw_smudge(light, x, y, 6.0, 0.12)
        radius = s.radius_um / s.pixel_size_um
        defocus = self.defocus(len(position), t)
        places = self.pixels(position)
        near = (np.abs(places - box / 2) <= box / 2 + 4 * radius).all(1) & np.isfinite(theta)
        for (x, y), heading, z, drawn in zip(places, theta, defocus, near, strict=True):
            if drawn:
                blur = math.hypot(s.blur_px, s.defocus_px * z)
                # y points down in the picture, so the heading changes sign.
                draw_sphere(light, x, y, -heading, radius, blur, z, s.cap_absorption)
        return light

    def render(self, position: np.ndarray, theta: np.ndarray, t: float) -> np.ndarray:
        """Return one frame (H, W) uint8 at `t` [s] of particles at `position` (N, 2) [m].

        `theta` (N,) are headings [rad], see `expose`; shot and read noise differ from call to
        call.

        Parameters
        ----------
        position : ndarray, shape (N, 2)
            Positions [m].
        theta : ndarray, shape (N,)
            Headings [rad].
        t : float
            Time [s].

        Returns
        -------
        ndarray, shape (H, W)
            Frame, uint8.
        """
        from microbot_ros.virtual_rig.optics import count_electrons

        s = self.settings
        light = self.expose(position, theta, t)
        starts = self._rng.integers(0, _NOISE_BANK - s.width_px, s.height_px)
        frame = np.empty(light.shape, np.uint8)
        count_electrons(light, self._noise, starts, 1 / s.electrons_per_level,
                        s.read_noise**2, frame)
        return frame

    def _illumination(self) -> np.ndarray:
        s = self.settings
        y, x = np.mgrid[-1:1:s.height_px * 1j, -1:1:s.width_px * 1j]
        light = (1 - s.vignette * (x**2 + y**2) / 2) * (1 + s.slope * (0.8 * x - 0.6 * y) / 2)
        return (s.brightness * light).astype(np.float32)

    def _stain(self) -> None:
        """Draw immobile objects: grains on the glass, and dust above and below it."""
        from microbot_ros.virtual_rig.optics import draw_smudge

        s, rng = self.settings, self._rng
        box = [s.width_px, s.height_px]
        for x, y in rng.uniform(0, 1, (s.specks, 2)) * box:
            draw_smudge(self._background, x, y, rng.uniform(0.6, 1.1), rng.uniform(0.15, 0.5))
        for x, y in rng.uniform(0, 1, (s.smudges, 2)) * box:
            draw_smudge(self._background, x, y, rng.uniform(3.5, 8), rng.uniform(0.03, 0.15))
