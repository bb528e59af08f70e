"""Filter bank for particles with a lagging heading and rotational diffusion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np

from microbot_ros.estimation.online.bank import PhasorBank


class HeadingBank(PhasorBank):
    """PhasorBank with the deviation of each heading from the model's as a third state.

    Where headings align at a finite rate, rotational diffusion makes them deviate by η from the
    course of the model. A deviation decays slowly, or grows while a turn is sharper than 90°. In
    the frame of c it is s = i c η, and displacements gain −i · b · s, with b the derivative of
    ∫e^{i(θ−φ)} dt by the heading. That is linear again. The noise acts across the direction of
    travel; its variance is split equally between the axes, which keeps the covariance isotropic.

    Given c, s has variance `s_var`, regression `gs` on c, and covariance `ps` = ½ E p̃ s̃*.

    Parameters
    ----------
    changes : int
        As for `PhasorBank`.
    paces : sequence of float, optional
        As for `PhasorBank`.
    """

    _ARRAYS: ClassVar[tuple[str, ...]] = (*PhasorBank._ARRAYS, 's', 'gs', 'ps', 's_var')
    """Names of all arrays (K, N)."""

    def __init__(self, changes: int, paces: Sequence[float] = ()) -> None:
        super().__init__(changes, paces)
        self._on_course()

    @classmethod
    def of(cls, bank: PhasorBank) -> Self:
        """Make a bank from one without headings.

        Parameters
        ----------
        bank : PhasorBank
            The particles.

        Returns
        -------
        HeadingBank
            The same particles, with headings that do not deviate.
        """
        grown = cls(bank._changes, bank._paces[bank._changes:].tolist())
        for name in PhasorBank._ARRAYS:
            setattr(grown, name, getattr(bank, name))
        grown._on_course()
        return grown

    def _on_course(self) -> None:
        self.s, self.gs, self.ps = (np.zeros(self.p.shape, complex) for _ in range(3))
        self.s_var = np.zeros(self.p.shape)

    def _births(
        self, position: np.ndarray, p_var: np.ndarray, phasor_var: float,
    ) -> dict[str, np.ndarray]:
        shape = self.p.shape[0], len(position)
        return super()._births(position, p_var, phasor_var) | {
            name: np.zeros(shape, complex) for name in ('s', 'gs', 'ps')
        } | {'s_var': np.zeros(shape)}

    def predict_deviation(
        self, sensitivity: np.ndarray, retention: np.ndarray, heading_noise: float,
    ) -> None:
        """Advance the deviations of headings to the next frame, and p by them; before `predict`.

        Parameters
        ----------
        sensitivity : ndarray of complex, shape (N,)
            Derivative of the path by the heading at the last frame [s], from
            `model.increments.heading_response`.
        retention : ndarray, shape (N,)
            Fraction of a deviation that remains at the next frame.
        heading_noise : float
            Variance 2 D_r h that rotational diffusion adds [rad²].
        """
        b = -1j * sensitivity
        floor = 1e-9 * (self.p_var + np.abs(b) ** 2 * self.s_var)
        self.p += b * self.s
        self.g += b * self.gs
        self.p_var = np.maximum(
            self.p_var + 2 * np.real(np.conj(b) * self.ps) + np.abs(b) ** 2 * self.s_var, floor
        )
        self.ps = retention * (self.ps + b * self.s_var)
        self.s *= retention
        self.gs *= retention
        added = np.abs(self.velocity_phasor) ** 2 * heading_noise / 2
        self.s_var = retention**2 * self.s_var + added
        self._bound()

    def update(self, z: np.ndarray, noise: np.ndarray, seen: np.ndarray) -> None:
        """Update with positions as the plain bank does, deviations included.

        Parameters
        ----------
        z : ndarray of complex, shape (N,)
            Positions [m].
        noise : ndarray, shape (N,)
            Variances of the readings [m²].
        seen : ndarray of bool, shape (N,)
            Which particles have a reading.
        """
        residual, given_c = z - self.p, self.p_var + noise
        total = given_c + np.abs(self.g) ** 2 * self.phasor_var
        gain = (np.conj(self.ps) + self.gs * np.conj(self.g) * self.phasor_var) / total
        self.s += np.where(seen, gain * residual, 0)
        self.gs -= np.where(seen, np.conj(self.ps) / given_c * self.g, 0)
        kept = np.where(seen, noise / given_c, 1)
        learned = np.where(seen, np.abs(self.ps) ** 2 / given_c, 0)
        # At least the rest after a perfect correlation: positive despite rounding errors.
        self.s_var = np.maximum(self.s_var - learned, self.s_var * kept)
        self.ps *= kept
        super().update(z, noise, seen)
        self._bound()

    def _fold(self, slot: int) -> np.ndarray:
        share = super()._fold(slot)
        for name in ('s', 'gs', 'ps', 's_var'):
            array = getattr(self, name)
            array[0] = np.where(share > 0.5, array[slot], array[0])
        self._bound()
        return share

    def _open(
        self, slot: int, probability: float, change_var: np.ndarray, phasor_var_max: float,
    ) -> None:
        super()._open(slot, probability, change_var, phasor_var_max)
        self.gs[slot] = self.gs[0] * self.phasor_var[0] / self.phasor_var[slot]
        self.s[slot], self.ps[slot], self.s_var[slot] = self.s[0], self.ps[0], self.s_var[0]

    def _bound(self) -> None:
        """Limit the correlation of p and s to 1 against rounding errors."""
        limit = np.sqrt(self.p_var * self.s_var)
        size = np.abs(self.ps)
        self.ps *= np.where(size > limit, limit / np.where(size > 0, size, 1), 1)
