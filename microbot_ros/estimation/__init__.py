"""Estimate speed, angle, delay and noise of particles, online and from recordings.

Examples
--------
>>> import numpy as np
>>> from microbot_ros.common.records import Commands, Session, Tracks
>>> from microbot_ros.estimation.batch import fit
>>> rng = np.random.default_rng(1)
>>> t, turn = np.arange(600) / 30, np.arange(10)
>>> angle = 2.4 * turn
>>> commands = Commands(2.0 * turn, 5e-3 * np.column_stack([np.cos(angle), np.sin(angle)]))
>>> step = 4e-6 / 30 * np.exp(1j * angle[(t / 2).astype(int)])
>>> path = np.cumsum(step + rng.normal(0, 5e-8, 600) + 1j * rng.normal(0, 5e-8, 600))
>>> tracks = Tracks(t, np.zeros(600, int), np.column_stack([path.real, path.imag]),
...                 np.full(600, np.nan), np.full(600, np.nan))
>>> found = fit(Session(tracks, commands))
>>> print(f'{found.polar.speed[0] * 1e6:.1f} µm/s, true: 4.0')
3.9 µm/s, true: 4.0
"""
