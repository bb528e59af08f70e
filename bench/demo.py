"""The closed loop, as `make demo` runs it: every figure that its summary names."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from bench.figure import Figure


def figures() -> list[Figure]:
    """Goal error, estimates, dropped frames, latency and line errors of one demo of 30 s."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / 'demo'
        subprocess.run([sys.executable, '-m', 'microbot_ros.cli', 'demo', '--out', str(out)],
                       check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        summary: dict[str, Any] = json.loads((out / 'summary.json').read_text())
    found = summary['estimate'].values()
    speed = max(abs(e['speed_um_s'] / e['true_speed_um_s'] - 1) for e in found)
    phi = max(abs(math.remainder(e['phi_rad'] - e['true_phi_rad'], math.tau)) for e in found)
    latency = summary['latency_ms']
    rows = [
        ('goal error, mean of the last 5 s', summary['goal_error_um'], 'µm', 5),
        ('largest error of a speed', 100 * speed, '%', 5),
        ('largest error of an offset angle', phi, 'rad', 0.1),
        ('frames dropped', summary['frames_dropped'], '', 0),
        ('exposure to acknowledgement, p50', latency['p50'], 'ms', 15),
        ('exposure to acknowledgement, p99', latency['p99'], 'ms', 50),
        ('CRC errors', summary['amplifier']['crc_errors'], '', 0),
    ]
    return [Figure(2, f'demo: {name}', value, unit, f'≤ {most}', 'truth of the virtual rig',
                   value <= most) for name, value, unit, most in rows]
