"""The filter bank for particles whose heading lags and is kicked about by the water."""

from __future__ import annotations

from typing import ClassVar, Self

import numpy as np

from microbot_ros.estimation.bank import PhasorBank


class HeadingBank(PhasorBank):
    """A PhasorBank with the stray of every heading from its course as a third state.

    Where headings align at a finite rate, rotational diffusion makes them stray by η about the
    course that the model gives, and what strays decays slowly, or grows while a turn is sharper
    than 90°. In the frame of c the stray is s = i c η: displacements gain −i · `bend` · s, with
    `bend` the derivative of ∫e^{i(θ−φ)} dt by the heading. That is linear again. The kicks act
    across the direction of travel; here their variance is shared between the axes, which keeps
    the covariance isotropic.

    Given c, s has variance `s_var`, regression `gs` on c, and covariance `ps` = ½ E p̃ s̃*.
    """

    _ARRAYS: ClassVar[tuple[str, ...]] = (*PhasorBank._ARRAYS, 's', 'gs', 'ps', 's_var')

    def __init__(self, hypotheses: int) -> None:
        super().__init__(hypotheses)
        self._rest()

    @classmethod
    def of(cls, bank: PhasorBank) -> Self:
        """The same particles, known as they are, with headings on course."""
        grown = cls(bank.p.shape[0])
        for name in PhasorBank._ARRAYS:
            setattr(grown, name, getattr(bank, name))
        grown._rest()
        return grown

    def _rest(self) -> None:
        self.s, self.gs, self.ps = (np.zeros(self.p.shape, complex) for _ in range(3))
        self.s_var = np.zeros(self.p.shape)

    def add(self, position: np.ndarray, p_var: np.ndarray, c_var: float) -> None:
        """Append particles, their headings on course."""
        super().add(position, p_var, c_var)
        born = self.p.shape[1] - self.s.shape[1]
        for name in ('s', 'gs', 'ps', 's_var'):
            setattr(self, name, np.pad(getattr(self, name), ((0, 0), (0, born))))

    def sway(self, bend: np.ndarray, kept: np.ndarray, spun: float) -> None:
        """What the strays do until the next frame; call before `predict`.

        `bend` (N,) complex [s] and `kept` (N,), the part of a stray that is left at the end, are
        those of `model.increments.heading_response`; `spun` = 2 D_r h is the variance [rad²] that
        rotational diffusion adds.
        """
        b = -1j * bend
        floor = 1e-9 * (self.p_var + np.abs(b) ** 2 * self.s_var)
        self.p += b * self.s
        self.g += b * self.gs
        self.p_var = np.maximum(
            self.p_var + 2 * np.real(np.conj(b) * self.ps) + np.abs(b) ** 2 * self.s_var, floor
        )
        self.ps = kept * (self.ps + b * self.s_var)
        self.s *= kept
        self.gs *= kept
        self.s_var = kept**2 * self.s_var + np.abs(self.c) ** 2 * spun / 2
        self._bound()

    def update(self, z: np.ndarray, noise: np.ndarray, seen: np.ndarray) -> None:
        """Take measurements as the plain bank does; strays learn from them too."""
        residual, total = self.innovation(z, noise)
        given_c = self.p_var + noise
        gain = (np.conj(self.ps) + self.gs * np.conj(self.g) * self.c_var) / total
        self.s += np.where(seen, gain * residual, 0)
        self.gs -= np.where(seen, np.conj(self.ps) / given_c * self.g, 0)
        kept = np.where(seen, noise / given_c, 1)
        learned = np.where(seen, np.abs(self.ps) ** 2 / given_c, 0)
        # At least what a perfect correlation would leave: positive whatever the rounding.
        self.s_var = np.maximum(self.s_var - learned, self.s_var * kept)
        self.ps *= kept
        super().update(z, noise, seen)
        self._bound()

    def restart_position(self, z: np.ndarray, noise: np.ndarray, where: np.ndarray) -> None:
        """Put particles back where they are seen; their strays stay."""
        super().restart_position(z, noise, where)
        self.ps = np.where(where, 0, self.ps)

    def _fold(self, slot: int) -> np.ndarray:
        share = super()._fold(slot)
        for name in ('s', 'gs', 'ps', 's_var'):
            array = getattr(self, name)
            array[0] = np.where(share > 0.5, array[slot], array[0])
        self._bound()
        return share

    def _open(
        self, slot: int, probability: float, change_var: np.ndarray, c_var_max: float,
    ) -> None:
        super()._open(slot, probability, change_var, c_var_max)
        self.gs[slot] = self.gs[0] * self.c_var[0] / self.c_var[slot]
        self.s[slot], self.ps[slot], self.s_var[slot] = self.s[0], self.ps[0], self.s_var[0]

    def _bound(self) -> None:
        """Rounding must not correlate p and s more than wholly."""
        limit = np.sqrt(self.p_var * self.s_var)
        size = np.abs(self.ps)
        self.ps *= np.where(size > limit, limit / np.where(size > 0, size, 1), 1)
