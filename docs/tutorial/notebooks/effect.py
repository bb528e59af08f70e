# %% [markdown]
# # Write an effect
#
# An effect is a class: parameters, and the hook of the stage that it changes. This one makes
# particles faster where the lamp is brighter. Simulate with it, then fit it to noisy positions
# and compare with the model that lacks it.

# %%
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from microbot_ros.common.records import Commands, Session, Tracks
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.estimation.likelihood.model_fit import fit_sessions, maximise
from microbot_ros.model.effect import Effect
from microbot_ros.model.effect_context import EffectContext
from microbot_ros.model.first_order import simulate
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.parameter import parameter


@dataclass(frozen=True)
class Brightness(Effect):
    """v → v (1 + east · x / 100 µm), never below zero."""

    id = 'brightness'
    stage = 'velocity'
    summary = 'Particles are faster on one side of the image.'
    required_excitation = 'tracks that cross the image'
    needs_position = True

    east: float = parameter('east', 'growth of the speed over 100 µm to the right', -2, 2, 0.1)

    def speed_factor(self, context: EffectContext) -> np.ndarray:
        return np.maximum(1 + self.east * context.position[..., 0] / 100e-6, 0.0)


# %% [markdown]
# Three particles for a minute, in a field that changes its direction every 3 s. Positions get
# diffusion and localisation error.

# %%
rng = np.random.default_rng(4)
turns = rng.uniform(-np.pi, np.pi, 20)
commands = Commands(3.0 * np.arange(20), 5e-3 * np.column_stack([np.cos(turns), np.sin(turns)]))
particles = ParticleParameters(
    np.arange(3), np.array([3e-6, 4e-6, 5e-6]), np.array([-2.0, 0.5, 3.0]))
times = np.arange(0.0, 60.0, 0.05)
start = 1e-6 * np.array([[-40.0, 0.0], [0.0, 30.0], [40.0, -20.0]])
path = simulate(Model(5e-3, effects=(Brightness(0.6),)), particles, commands, times, start)
path += np.cumsum(rng.normal(0, np.sqrt(2 * 4e-14 * 0.05), path.shape), axis=0)
path += rng.normal(0, 1e-7, path.shape)
count = path.shape[0] * path.shape[1]
tracks = Tracks(np.repeat(times, 3), np.tile(np.arange(3), len(times)), path.reshape(count, 2),
                np.full(count, np.nan), np.full(count, np.nan))

# %% [markdown]
# Fit both models. `cost` is −2 log likelihood.

# %%
prepared, _ = check_sessions([Session(tracks, commands)])
without = fit_sessions(Model(5e-3), prepared)
found = maximise(without.under(Model(5e-3, effects=(Brightness(0.05),))))
[declared] = Brightness.parameters()
std = declared.scale * np.sqrt(found.covariance[0, 0])  # fits count in typical sizes
print(f'east = {found.model.effects[0].east:.2f} ± {1.96 * std:.2f} (95 %), true: 0.60')
print(f'−2 log likelihood falls by {without.cost - found.cost:.0f}')

# %%
figure, axes = plt.subplots(figsize=(5, 3.5), layout='constrained')
for k in range(3):
    axes.plot(*(1e6 * path[:, k].T), label=f'particle {k}')
axes.set(xlabel='x (µm)', ylabel='y (µm)', aspect='equal')
axes.legend()

# %% [markdown]
# To have it searched by `microbot discover`, kept in `model.yaml` and used by nodes and
# controllers, put the class into a package: [effects, and one of your
# own](../../how-to/effect.md).
