"""Figure of what the tracker searches for, and what it found."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.tracking.locate.detect import Detections
from microbot_ros.tracking.refine.appearance import Appearance
from microbot_ros.tracking.refine.fit import TABLE_STEP
from microbot_ros.tracking.settings import TrackerSettings


def write_settings_figure(
    path: Path, image: np.ndarray, found: Detections, appearance: Appearance,
    settings: TrackerSettings,
) -> None:
    """Save a figure to `path`: `image`, what was `found`, learned picture, profile, settings.

    `appearance` holds the learned picture, `settings` the settings.

    Parameters
    ----------
    path : Path
        File to write.
    image : ndarray, shape (H, W)
        The picture.
    found : Detections
        The detections.
    appearance : Appearance
        The learned picture.
    settings : TrackerSettings
        Settings of the tracker.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 8), layout='constrained')
    frame, profile, words = figure.subplot_mosaic(
        [['frame', 'profile'], ['frame', 'words']], width_ratios=[2.4, 1]).values()
    darkest, brightest = np.quantile(image, [0.001, 0.999])
    frame.imshow(image, cmap='gray', vmin=darkest, vmax=brightest)
    frame.scatter(found.xy[:, 0], found.xy[:, 1], s=60, facecolors='none',
                  edgecolors='tab:orange', linewidths=0.8)
    frame.set(title=f'{len(found)} particles in this frame', xlabel='x [px]', ylabel='y [px]')
    radii = np.arange(appearance.table.shape[1]) * TABLE_STEP
    near = radii <= appearance.reach_px + 1
    for harmonic, label in enumerate(['round part', 'cap', 'cap, second'][:len(appearance.table)]):
        profile.plot(radii[near], appearance.contrast_grey * appearance.table[harmonic, near],
                     label=label)
    profile.axvline(appearance.diameter_px / 2, color='0.6', linestyle=':', label='radius')
    profile.set(title='the typical particle', xlabel='distance from the centre [px]',
                ylabel='contrast [grey levels]')
    profile.legend(loc='upper center', bbox_to_anchor=(0.5, -0.12), ncols=2)
    words.axis('off')
    words.text(0, 1, '\n'.join(_explain(appearance, settings)), va='top', family='monospace',
               fontsize=8, wrap=True)
    figure.savefig(path, dpi=110)


def _explain(appearance: Appearance, settings: TrackerSettings) -> list[str]:
    lines = ['found from the first frames:', *(f'  {line}' for line in appearance.describe())]
    lines += ['', 'settings (none: as found above):']
    for name, value in settings.content().items():
        chosen = '' if name in settings.given else ' (default)'
        lines.append(f'  {name}: {"none" if value is None else value}{chosen}')
    return lines
