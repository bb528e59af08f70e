# %% [markdown]
# # Find a hidden effect
#
# Hide a slow flow in a simulated recording and let the search find it.

# %%
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from microbot_ros.discovery.discover import discover
from microbot_ros.virtual_rig.scenario import read_scenario
from microbot_ros.virtual_rig.simulation import run

SCENARIO = """
duration_s: 60
seed: 3
radius_um: 4.6
reference_field_mT: 5.0
fluid: {viscosity_mPa_s: 1.245}
camera: {frame_rate_hz: 20, localisation_um: 0.1}
particles:
  - {x_um: -60, y_um: 20, v_um_s: 3.7, phi_rad: -1.1}
  - {x_um: 40, y_um: 50, v_um_s: 4.4, phi_rad: 0.7}
  - {x_um: 10, y_um: -60, v_um_s: 5.0, phi_rad: 2.6}
commands:
  steps: {field_mT: 5.0, dwell_s: [1, 3]}
effects:
  uniform_drift: {wx_um_s: 0.6, wy_um_s: -0.4}
"""

# %%
with TemporaryDirectory() as folder:
    file = Path(folder) / 'hidden.yaml'
    file.write_text(SCENARIO)
    scenario, particles = read_scenario(file)
session = run(scenario, particles, 'hidden.yaml')
found = discover([session])
print(found.verdict)

# %% [markdown]
# *Established* effects, their parameters with 95 % intervals, and the log evidence: the natural
# logarithm of how much more likely the recording is with the effect than without. [What the
# words promise](../../explanation/discovery.md).

# %%
for effect in found.effects:
    print(f'{effect.status} {effect.id}, log evidence {effect.log_evidence:.0f}')
    for name, estimate in effect.parameters.items():
        print(f'  {name}: {estimate.value * 1e6:.2f} '
              f'({estimate.low * 1e6:.2f} to {estimate.high * 1e6:.2f})')

# %% [markdown]
# How much better does the model predict data that it was not fitted to? Values are beyond the
# noise.

# %%
gap = found.gap
figure, axes = plt.subplots(figsize=(5, 2), layout='constrained')
bars = axes.barh(['without effect', 'with effect', 'noise floor'],
                 [1e6 * value for value in (gap.before, gap.after, gap.floor)])
axes.bar_label(bars, fmt='%.2f', padding=3)
axes.margins(x=0.15)
axes.invert_yaxis()
axes.set_xlabel(f'error of a prediction {gap.horizon:g} s ahead (µm)')
