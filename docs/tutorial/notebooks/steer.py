# %% [markdown]
# # Steer a simulated particle
#
# Two particles swim in one field. A controller drives particle 0 through two goals; its model
# learns speed and angle on the way. Everything runs in one process, without ROS and faster than
# real time.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

from microbot_ros.virtual_rig.scenario import read_scenario
from microbot_ros.virtual_rig.simulation import run

SCENARIO = """
duration_s: 60
seed: 1
radius_um: 2.3
reference_field_mT: 5.0
fluid: {viscosity_mPa_s: 1.245}
camera: {frame_rate_hz: 30, localisation_um: 0.1}
particles:
  - {x_um: -60, y_um: 20, v_um_s: 3.71, phi_rad: -1.09}
  - {x_um: 40, y_um: 50, v_um_s: 4.38, phi_rad: 3.82}
controller:
  name: waypoint
  goals_um: [[-20, 40], [-50, -20]]
"""

# %% [markdown]
# A scenario is a YAML file; all keys are in the [reference](../../reference/simulation.md).
# `run` returns a session: tracks and commands, as from a rig.

# %%
with TemporaryDirectory() as folder:
    file = Path(folder) / 'scenario.yaml'
    file.write_text(SCENARIO)
    scenario, particles = read_scenario(file)
session = run(scenario, particles, 'scenario.yaml')
tracks, commands = session.tracks, session.commands
print(f'{len(tracks.particles)} particles, {len(tracks.t)} positions, {len(commands.t)} commands')

# %% [markdown]
# How near did the driven particle come to each goal? Arrays are in SI units.

# %%
GOALS = 1e-6 * np.array([[-20, 40], [-50, -20]])
driven = tracks.of(0)
for goal in GOALS:
    distance = np.hypot(*(driven.position - goal).T)
    print(f'goal {goal * 1e6} µm: nearest {distance.min() * 1e6:.1f} µm, '
          f'after {driven.t[distance.argmin()]:.0f} s')

# %%
figure, axes = plt.subplots(figsize=(5, 4), layout='constrained')
for particle in tracks.particles:
    axes.plot(*(1e6 * tracks.of(particle).position.T), label=f'particle {particle}')
axes.plot(*(1e6 * GOALS.T), 'k+', markersize=12, label='goals')
axes.set(xlabel='x (µm)', ylabel='y (µm)', aspect='equal')
axes.legend()
