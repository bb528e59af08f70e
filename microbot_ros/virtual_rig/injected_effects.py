"""Effects that can be hidden in the simulated world, by name.

Those of the library have their ids and parameters, so that a search can be scored against them.
Others are in no library; a search must not give them a wrong name.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from microbot_ros.common.units import to_si
from microbot_ros.virtual_rig.coil_gradients import pull_of_coil, pull_of_pair

# Effect → parameter in display units → column of the particle's record.
LISTED: dict[str, dict[str, str]] = {
    'uniform_drift': {'wx_um_s': 'drift_x', 'wy_um_s': 'drift_y'},
    'linear_flow': {
        'gxx_per_s': 'gxx', 'gxy_per_s': 'gxy', 'gyx_per_s': 'gyx', 'gyy_per_s': 'gyy'},
    'alignment_lag': {'tau_s': 'moment'},
    'background_field': {'bx_mT': 'background_x', 'by_mT': 'background_y'},
    'coil_gain_mismatch': {'gain_ratio': 'gain_y'},
    'coil_misalignment': {'skew_rad': 'skew'},
    'speed_decay': {'tau_s': 'fuel_time'},
    'command_delay': {'delay_s': 'delay'},
    'heading_slip': {'rate_rad_s': 'slip_rate'},
    'dipole_interaction': {'strength_um5_s': 'dipole'},
    'hydrodynamic_slowdown': {'length_um': 'crowding'},
    'hot_spot': {
        'x_um': 'spot_x', 'y_um': 'spot_y', 'speed_um_s': 'spot_speed', 'width_um': 'spot_width'},
    'periodic_drift': {
        'amplitude_um_s': 'sway_speed', 'frequency_hz': 'sway_frequency',
        'direction_rad': 'sway_direction', 'phase_rad': 'sway_phase'},
    'amplifier_deadband': {'deadband_mT': 'deadband'},
    'pixel_anisotropy': {'aspect': 'aspect'},
    'gradient_force': {'rate_per_s_mT': 'pair_moment'},
    'coil_pull': {'rate_um_s_mT': 'coil_moment'},
    'incomplete_alignment': {'field_scale_mT': 'field_scale'},
    # The first two alone are the mechanics of rollers; all five are the curves of the library.
    'drive_response': {
        'cut_in_hz': 'cut_in', 'step_out_hz': 'step_out', 'slip': 'slip',
        'cut_in_steepness': 'cut_in_steepness', 'step_out_steepness': 'step_out_steepness'},
}

UNLISTED: dict[str, dict[str, str]] = {
    'poiseuille_flow': {'speed_um_s': 'channel_speed', 'half_width_um': 'channel_half_width'},
    'chirality': {'spin_rad_s': 'spin'},
    'speed_by_place': {'length_um': 'uphill_length'},
    'pulsing_speed': {'depth': 'pulse_depth', 'frequency_hz': 'pulse_frequency'},
    'speed_by_heading': {'depth': 'facing'},
    'lamp_change': {'time_s': 'dim_time', 'factor': 'dim_factor'},
    'stage_jump': {'time_s': 'jump_time', 'x_um': 'jump_x', 'y_um': 'jump_y'},
    'heading_wobble': {'angle_rad': 'wobble_angle', 'frequency_hz': 'wobble_frequency'},
    'settling_flow': {
        'wx_um_s': 'settling_x', 'wy_um_s': 'settling_y', 'tau_s': 'settling_time'},
    'trap': {'speed_um_s': 'trap_speed', 'length_um': 'trap_length'},
    'repulsion': {'speed_um_s': 'repulsion_speed', 'range_um': 'repulsion_range'},
    'swimmer_flow': {'strength_um3_s': 'pusher'},
}

INJECTABLE = LISTED | UNLISTED

# Columns used as divisors, or undefined at zero.
_POSITIVE = {
    'moment', 'fuel_time', 'spot_width', 'step_out', 'channel_half_width', 'uphill_length',
    'settling_time', 'trap_length', 'repulsion_range', 'aspect', 'gain_y',
}
_NOT_NEGATIVE = {'delay', 'deadband', 'field_scale', 'cut_in'}


def check(effect: str, parameters: Mapping[str, float | Sequence[float]]) -> None:
    """Raise ValueError for an unknown `effect`, or impossible `parameters`.

    Parameters
    ----------
    effect : str
        Id of the effect.
    parameters : mapping of str to float or sequence of float
        Values by name.
    """
    if effect not in INJECTABLE:
        raise ValueError(f"unknown effect '{effect}'; expected one of: {', '.join(INJECTABLE)}")
    known = INJECTABLE[effect]
    for name, value in parameters.items():
        if name not in known:
            raise ValueError(
                f"unknown parameter '{name}' of {effect}; expected one of: {', '.join(known)}")
        if not np.isfinite(value).all():
            raise ValueError(f'{effect} {name} must be finite; received {value}')
        if known[name] in _POSITIVE and not np.greater(value, 0).all():
            raise ValueError(f'{effect} {name} must be positive; received {value}')
        if known[name] in _NOT_NEGATIVE and not np.greater_equal(value, 0).all():
            raise ValueError(f'{effect} {name} must not be negative; received {value}')
    missing = [name for name in known if name not in parameters]
    if effect == 'drive_response' and 'slip' in parameters and missing:
        raise ValueError(f'{effect} with a slip expects also: {", ".join(missing)}')


def inject_effect(
    bodies: np.ndarray, effect: str, parameters: Mapping[str, float | Sequence[float]],
    reference_field: float,
) -> None:
    """Add an effect to particles, in place; parameters that are not given stay.

    A lag sets the magnetic moment that aligns the heading with the time constant `tau_s` at the
    reference field; `gradient_force` and `coil_pull` set a moment that the gradients of the
    default coils pull at the given rate at the centre. Raises ValueError as `check`.

    Parameters
    ----------
    bodies : (N,) array of BODY
        Particles, changed in place.
    effect : str
        Name of the effect.
    parameters : mapping of str to float or N floats
        Values by name of the parameter.
    reference_field : float [T]
        Field at which `tau_s` is the time constant.
    """
    check(effect, parameters)
    for name, value in parameters.items():
        strength = to_si(name, np.asarray(value, dtype=float))
        if effect == 'alignment_lag':
            strength = bodies['turn_drag'] / (strength * reference_field)
        elif effect == 'gradient_force':
            strength = strength / pull_of_pair()
        elif effect == 'coil_pull':
            strength = strength / pull_of_coil()
        bodies[INJECTABLE[effect][name]] = strength
