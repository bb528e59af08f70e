"""Record of one simulated particle: state, properties and disturbances.

Every disturbance of the simulated world is a column with a null value, so that each particle can
have its own strength of each. All values are SI.
"""

from __future__ import annotations

import math

import numpy as np

from microbot_ros.model.physics.particle import (
    Fluid,
    rotational_diffusion,
    rotational_drag,
    stokes_drag,
    translational_diffusion,
)

# Column → value without effect. State and properties of the sphere come first.
_NULL_VALUES = {
    'x': 0.0, 'y': 0.0, 'heading': 0.0, 'phi': 0.0, 'fuel': 1.0,
    'radius': 0.0, 'drag': 1.0, 'turn_drag': 1.0, 'diffusion': 0.0, 'rotational_diffusion': 0.0,
    'speed': 0.0, 'gain': 0.0, 'moment': 0.0, 'turns': 0.0,
    # amplifier, coils and stray field
    'delay': 0.0, 'deadband': 0.0, 'gain_y': 1.0, 'skew': 0.0,
    'background_x': 0.0, 'background_y': 0.0,
    # body
    'fuel_time': math.inf, 'slip_rate': 0.0, 'field_scale': 0.0,
    'cut_in': 0.0, 'step_out': math.inf, 'slip': 0.0,
    'cut_in_steepness': 0.0, 'step_out_steepness': 0.0,
    # fluid and forces
    'drift_x': 0.0, 'drift_y': 0.0, 'gxx': 0.0, 'gxy': 0.0, 'gyx': 0.0, 'gyy': 0.0,
    'sway_speed': 0.0, 'sway_frequency': 0.0, 'sway_direction': 0.0, 'sway_phase': 0.0,
    'spot_x': 0.0, 'spot_y': 0.0, 'spot_speed': 0.0, 'spot_width': 1.0,
    # moments over drag [m²/(T s)], pulled by a pair of coils on each axis; by one coil
    'pair_moment': 0.0, 'coil_moment': 0.0,
    # neighbours
    'dipole': 0.0, 'crowding': 0.0, 'repulsion_speed': 0.0, 'repulsion_range': 1.0,
    'pusher': 0.0, 'stir': 0.0,
    # camera
    'aspect': 1.0, 'jump_time': math.inf, 'jump_x': 0.0, 'jump_y': 0.0,
    # not in the library of effects
    'channel_speed': 0.0, 'channel_half_width': 1.0, 'spin': 0.0, 'uphill_length': math.inf,
    'pulse_depth': 0.0, 'pulse_frequency': 0.0, 'facing': 0.0, 'dim_time': math.inf,
    'dim_factor': 1.0, 'wobble_angle': 0.0, 'wobble_frequency': 0.0,
    'settling_x': 0.0, 'settling_y': 0.0, 'settling_time': math.inf,
    'trap_speed': 0.0, 'trap_length': 1.0,
}

BODY = np.dtype([(name, np.float64) for name in _NULL_VALUES])
"""One particle; columns in the order of the chain from amplifier to camera."""


def bodies(
    fluid: Fluid,
    radius: np.ndarray,
    moment: np.ndarray | float,
    phi: np.ndarray,
    position: np.ndarray,
    *,
    speed: np.ndarray | float = 0.0,
    gain: np.ndarray | float = 0.0,
    heading: np.ndarray | float = 0.0,
) -> np.ndarray:
    """Return undisturbed particles (N,) of type BODY, with Stokes drag and Einstein diffusion.

    Parameters
    ----------
    fluid : Fluid
        Fluid that drags the particles.
    radius : (N,) array [m]
        Radius of each sphere.
    moment : (N,) array or float [A·m²]
        Magnetic moment.
    phi : (N,) array [rad]
        Angle from the field to the heading of an aligned particle.
    position : (N, 2) array [m]
        Position of each particle.
    speed : (N,) array or float [m/s]
        Of a swimmer with full fuel.
    gain : (N,) array or float [m/s/Hz]
        Of a roller.
    heading : (N,) array or float [rad]
        Heading of each particle.

    Returns
    -------
    ndarray, shape (N,)
        BODY of each particle.
    """
    radius = np.asarray(radius, dtype=float)
    result = np.empty(len(radius), BODY)
    for name, null_value in _NULL_VALUES.items():
        result[name] = null_value
    result['x'], result['y'] = np.asarray(position, dtype=float).T
    result['drag'] = stokes_drag(fluid, radius)
    result['turn_drag'] = rotational_drag(fluid, radius)
    result['diffusion'] = translational_diffusion(fluid, radius)
    result['rotational_diffusion'] = rotational_diffusion(fluid, radius)
    given = {'radius': radius, 'moment': moment, 'phi': phi, 'speed': speed, 'gain': gain}
    for name, value in (given | {'heading': heading}).items():
        result[name] = value
    return result
