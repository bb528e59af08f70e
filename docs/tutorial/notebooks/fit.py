# %% [markdown]
# # Fit and plot a session
#
# Estimate speed v and angle φ of every particle, the diffusion coefficient and the localisation
# error of a recording. The recording is the paper's experiment, simulated: three particles, 15
# s. Use `read_session('FOLDER')` for your own.

# %%
import matplotlib.pyplot as plt
import numpy as np

from microbot_ros.estimation.batch import fit
from microbot_ros.paper.repetition import record

session = record(seed=1)
found = fit(session)

# %% [markdown]
# Each number has a standard deviation.

# %%
for k, particle in enumerate(found.ids):
    polar = found.polar
    print(f'particle {particle}: v = {polar.speed[k] * 1e6:.2f} ± '
          f'{1.96 * polar.speed_std[k] * 1e6:.2f} µm/s, φ = {polar.phi[k]:.3f} ± '
          f'{1.96 * polar.phi_std[k]:.3f} rad (95 %)')
print(f'D = {found.noise.diffusion * 1e12:.4f} µm²/s, '
      f'localisation {found.noise.localisation * 1e9:.0f} nm')

# %% [markdown]
# Measured tracks, and those that the model computes from the commands alone.

# %%
figure, axes = plt.subplots(figsize=(5, 4), layout='constrained')
for k, particle in enumerate(found.ids):
    measured, predicted = 1e6 * found.measured[:, k], 1e6 * found.predicted[:, k]
    [line] = axes.plot(measured.real, measured.imag, label=f'particle {particle}')
    axes.plot(predicted.real, predicted.imag, '--', color=line.get_color())
axes.set(xlabel='x (µm)', ylabel='y (µm)', aspect='equal')
axes.legend(title='dashed: model')

# %% [markdown]
# The distance between both grows with time, because particles diffuse.

# %%
gap = np.abs(found.predicted - found.measured)
print(f'distance of model and measurement: mean {np.nanmean(gap) * 1e6:.2f} µm, '
      f'at the end {np.nanmean(gap[-30:]) * 1e6:.2f} µm')
