"""The picture of a coil calibration from tracks."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from microbot_ros.discovery.coil_map import CoilMap


def draw_deviations(found: CoilMap, path: Path) -> None:
    """To `path`: which way particles went beside the command, the field `found`, and residuals."""
    from matplotlib.figure import Figure
    figure = Figure(figsize=(8, 4.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    seen = found.deviations
    at, std = np.degrees(seen.commanded), 2 * np.degrees(seen.std)
    circle = np.linspace(-np.pi, np.pi, 361)
    above.plot(np.degrees(circle), np.degrees(found.expected(circle)), color='C1',
               label=f'fitted field at {1e3 * found.strength:.3g} mT')
    above.errorbar(at, np.degrees(seen.deviation), std, fmt='o', color='C0', markersize=4,
                   label='tracks, ± 2 std')
    gain, skew = found.gain_ratio, found.skew
    above.set(ylabel='beside the command [°]',
              title=f'Gain of y over x coils {gain.value:.3f} ± {gain.std:.3f}, '
                    f'lean {np.degrees(skew.value):.2f} ± {np.degrees(skew.std):.2f}°')
    above.legend()
    left = np.degrees(seen.deviation - found.expected(seen.commanded))
    below.errorbar(at, left, std, fmt='o', color='C0', markersize=4)
    for axis in (above, below):
        axis.axhline(0, color='0.7', linewidth=0.8, zorder=0)
    below.set(xlabel='commanded direction [°]', ylabel='residual [°]', xlim=(-185, 185),
              xticks=range(-180, 181, 45))
    figure.savefig(path, dpi=150)
