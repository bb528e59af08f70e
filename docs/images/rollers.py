"""Draws `rollers.png`: `python docs/images/rollers.py` (some minutes)."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes

import bench.rollers
from bench._rolling_loop import RollingLoop
from bench.rollers import PATHS, WALLS_UM, passage, push

_RADIUS_UM = 2.3


class _Filmed(RollingLoop):
    """Notes where all are, at each frame."""

    film: ClassVar[list[np.ndarray]] = []

    def _advance(self, until: float) -> None:
        super()._advance(until)
        self.film.append(1e6 * self.world.position)


def _draw(axes: Axes, title: str) -> None:
    """What was filmed last."""
    film = np.array(_Filmed.film)
    _Filmed.film.clear()
    colours = plt.get_cmap('tab10').colors  # type: ignore[attr-defined]
    for k, way in enumerate(film.swapaxes(0, 1)):
        axes.plot(*way[::10].T, color=colours[k % 10], linewidth=0.7)
        for place, face in ((way[0], 'none'), (way[-1], colours[k % 10])):
            axes.add_patch(plt.Circle(tuple(place), _RADIUS_UM, facecolor=face,
                                      edgecolor=colours[k % 10]))
    axes.set(title=title, xlabel='x (µm)', ylabel='y (µm)', aspect='equal')


def main() -> None:
    """Ten through a slit, and a bead along an S."""
    bench.rollers.RollingLoop = _Filmed  # type: ignore[misc]
    mpl.use('Agg')
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(12, 4.6), width_ratios=(1.25, 1), layout='constrained')
    passage(0)
    _draw(left, 'ten rollers, one field (circles: where they began)')
    for wall in np.array(WALLS_UM).reshape(-1, 4):
        left.plot(wall[::2], wall[1::2], color='black', linewidth=3)
    path = 1e6 * PATHS['an S']
    right.plot(*path.T, color='0.8', linewidth=6)
    push(0, PATHS['an S'])
    _draw(right, 'a roller (blue) pushes a bead (orange)')
    figure.savefig(Path(__file__).with_suffix('.png'), dpi=100)


if __name__ == '__main__':
    main()
