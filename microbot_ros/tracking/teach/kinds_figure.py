"""Figure of what was taught: followed, standing still, left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from microbot_ros.tracking.locate.bodies import find_bodies
from microbot_ros.tracking.locate.kinds import TRAITS
from microbot_ros.tracking.locate.kinds_detector import KindsDetector
from microbot_ros.tracking.settings import TrackerSettings

_SHOWN = 6
"""Choice: cut-outs shown of each kind."""


def write_kinds_figure(path: Path, image: np.ndarray, settings: TrackerSettings) -> None:
    """Save a figure to `path`: an `image` (H, W) with what `settings` follow and leave out.

    It adds cut-outs of each kind and their ranges in words.

    Parameters
    ----------
    path : Path
        File to write.
    image : ndarray, shape (H, W)
        The picture.
    settings : TrackerSettings
        Settings of the tracker.
    """
    from matplotlib.figure import Figure

    found = KindsDetector(settings.kinds, settings.standing).detect(image, np.empty((0, 2)))
    count = len(settings.kinds)
    figure = Figure(figsize=(12, 7 + 1.6 * count), layout='constrained')
    halves: Any = figure.subfigures(2, 1, height_ratios=[4, count])
    top, below = halves
    frame, words = top.subplots(1, 2, width_ratios=[2.4, 1])
    shades = {'cmap': 'gray', 'vmin': np.quantile(image, 0.001), 'vmax': np.quantile(image, 0.999)}
    frame.imshow(image, **shades)
    left = np.array([body for kind in settings.kinds for body in find_bodies(
        image, kind.dark, 0.6 * kind.height_grey[0], kind.shrink, kind.width_px[1],
        kind.parts_px).xy]).reshape(-1, 2)
    away = np.linalg.norm(left[:, None] - found.xy, axis=2)
    left = left[np.all(away > found.radius, axis=1)]
    frame.plot(*left.T, 'x', color='0.6', markersize=4, label='left out')
    for k, kind in enumerate(settings.kinds):
        of_kind = found.kind == k
        frame.plot(*found.xy[of_kind].T, 'o', color=f'C{k}', fillstyle='none', markersize=9,
                   label=f'{kind.name}: {of_kind.sum()}')
    frame.plot([place.x_px for place in settings.standing],
               [place.y_px for place in settings.standing], 's', color='tab:red',
               fillstyle='none', label='stands still')
    frame.legend(loc='upper right', fontsize=8)
    words.axis('off')
    words.text(0, 1, '\n'.join(_explained(settings)), va='top', family='monospace', fontsize=8)
    axes = below.subplots(count, _SHOWN, squeeze=False)
    for k, kind in enumerate(settings.kinds):
        _cut_out(axes[k], image, found.xy[found.kind == k], kind.typical_width_px, shades)
        axes[k, 0].set_title(kind.name, fontsize=8, loc='left')
    figure.savefig(path, dpi=110)


def _cut_out(axes: np.ndarray, image: np.ndarray, places: np.ndarray, width: float,
             shades: dict[str, object]) -> None:
    for axis in axes:
        axis.axis('off')
    reach = int(1.5 * width) + 4
    for axis, (x, y) in zip(axes, np.rint(places).astype(int), strict=False):
        axis.imshow(image[max(y - reach, 0):y + reach + 1, max(x - reach, 0):x + reach + 1],
                    **shades)


def _explained(settings: TrackerSettings) -> list[str]:
    lines = []
    if settings.colour is not None:
        lines = ['seen as {:+g} red {:+g} green {:+g} blue'.format(*settings.colour)]
    for kind in settings.kinds:
        lines += [f'{kind.name}: {kind.contrast}, {len(kind.like)} examples, '
                  f'{len(kind.unlike)} counter-examples']
        lines += [f'  {name}: {getattr(kind, name)[0]:g} to {getattr(kind, name)[1]:g}'
                  for name in TRAITS]
    return [*lines, '', f'{len(settings.standing)} places stand still and are left out']
