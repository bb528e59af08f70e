"""Compiled motion of simulated particles in one short step.

Each function is one cause. They read a particle's record (`body.BODY`) and share no code with the
model that is fitted. `advance` combines them. Causes that a body does not have are skipped, since
their sines and exponentials take a third of the time. All are in one file because numba's cache
notices changes in the caller's own file only: after a change to `langevin.step_heading` or to
`coil_gradients.SPACING`, touch this one.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from microbot_ros.common.compiled import numba
from microbot_ros.model.physics.langevin import step_heading
from microbot_ros.virtual_rig.coil_gradients import SPACING

Pair = tuple[float, float]


@numba.njit(cache=True)
def _deadband(value: float, width: float) -> float:
    """Return the output of an amplifier that loses the first `width` of its input."""
    return math.copysign(max(abs(value) - width, 0.0), value)


@numba.njit(cache=True)
def coil_fields(body: Any, x: float, y: float) -> Pair:
    """Return the fields [T] of the coils of each axis at a `body` for a command `x`, `y` [T].

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    x : float
        Component of the command along x [T].
    y : float
        Component of the command along y [T].

    Returns
    -------
    Pair
        Fields [T].
    """
    return _deadband(x, body.deadband), body.gain_y * _deadband(y, body.deadband)


@numba.njit(cache=True)
def felt_field(body: Any, x: float, y: float) -> Pair:
    """Return the field [T] at a `body` from the fields `x`, `y` [T] of the coils of each axis.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    x : float
        Field of the coils of the x axis [T].
    y : float
        Field of the coils of the y axis [T].

    Returns
    -------
    Pair
        Field [T].
    """
    return (
        x + math.sin(body.skew) * y + body.background_x,
        math.cos(body.skew) * y + body.background_y,
    )


@numba.njit(cache=True)
def feel(bodies: np.ndarray, field: np.ndarray) -> None:
    """Replace commands by the fields at the bodies, in place.

    Parameters
    ----------
    bodies : ndarray, shape (N,)
        BODY of each particle.
    field : ndarray, shape (N, 2)
        Command at each body [T]; afterwards the field that it feels [T].
    """
    for i in range(len(bodies)):
        x, y = coil_fields(bodies[i], field[i, 0], field[i, 1])
        field[i] = felt_field(bodies[i], x, y)


@numba.njit(cache=True)
def _hill(drive: float, half: float, steepness: float) -> float:
    """Return a curve from 0 to 1 that is ½ at `half`."""
    return 1.0 if half == 0 else 1 / (1 + (half / drive) ** steepness)


@numba.njit(cache=True)
def roll_frequency(body: Any, frequency: float) -> float:
    """Return the mean frequency [Hz] of a particle in a field that rotates at `frequency` [Hz].

    Below cut-in the surface holds it, above it rolls at √(f² − cut_in²); beyond step-out it slips
    and keeps f − √(f² − step_out²) (averaged Adler equation, for either barrier alone). If the
    `body` has a steepness, empirical curves apply.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    frequency : float
        Frequency of the field [Hz].

    Returns
    -------
    float
        Frequency [Hz].
    """
    drive = abs(frequency)
    if drive == 0:
        return 0.0
    if body.cut_in_steepness > 0:
        rolled = drive * _hill(drive, body.cut_in, body.cut_in_steepness)
        rolled *= 1 - body.slip * _hill(drive, body.step_out, body.step_out_steepness)
    else:
        rolled = math.sqrt(max(drive**2 - min(body.cut_in, body.step_out)**2, 0.0))
        if drive > body.step_out:
            rolled *= 1 - math.sqrt(1 - (body.step_out / drive) ** 2)
    return math.copysign(rolled, frequency)


@numba.njit(cache=True)
def own_speed(body: Any, frequency: float, t: float) -> float:
    """Return the speed [m/s] of a body along its heading at `t` [s], by fuel or by rolling.

    Slowing by neighbours is not included. `frequency` [Hz] is that of the field.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    frequency : float
        Frequency of the field [Hz].
    t : float
        Time [s].

    Returns
    -------
    float
        Speed [m/s].
    """
    speed = body.speed * body.fuel + body.gain * roll_frequency(body, frequency)
    if body.pulse_depth != 0:
        speed *= 1 + body.pulse_depth * math.sin(2 * math.pi * body.pulse_frequency * t)
    facing = body.facing * math.cos(3 * body.heading) if body.facing != 0 else 0.0
    speed *= 1 + body.x / body.uphill_length + facing
    return speed * body.dim_factor if t >= body.dim_time else speed


@numba.njit(cache=True)
def tilt(body: Any, strength: float, rng: np.random.Generator) -> Pair:
    """Draw the components of a body's axis along and across its mean heading (Boltzmann).

    The angle of the axis from the field of `strength` |B| [T] has the density exp(κ cos ϑ) on the
    sphere, κ = |B|/b₀.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    strength : float
        Magnitude of the field [T].
    rng : random.Generator
        Source of random numbers.

    Returns
    -------
    Pair
        Components of the unit vector.
    """
    if body.field_scale == 0:
        return 1.0, 0.0
    kappa, uniform = strength / body.field_scale, rng.random()
    if kappa < 1e-6:
        along = 2 * uniform - 1
    else:
        along = 1 + math.log(uniform + (1 - uniform) * math.exp(-2 * kappa)) / kappa
    across = math.sqrt(max(1 - along**2, 0.0)) * math.cos(2 * math.pi * rng.random())
    return along, across


@numba.njit(cache=True)
def flow(body: Any, t: float) -> tuple[float, float, float]:
    """Return velocity [m/s] and rotation [rad/s] (half the vorticity) at a `body` at `t` [s].

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    t : float
        Time [s].

    Returns
    -------
    tuple[float, float, float]
        Velocity along x and y [m/s], and rotation [rad/s].
    """
    profile = (body.y / body.channel_half_width) ** 2
    u = body.drift_x + body.gxx * body.x + body.gxy * body.y + body.channel_speed * (1 - profile)
    v = body.drift_y + body.gyx * body.x + body.gyy * body.y
    if body.sway_speed != 0:
        phase = 2 * math.pi * body.sway_frequency * t + body.sway_phase
        sway = body.sway_speed * math.cos(phase)
        u += sway * math.cos(body.sway_direction)
        v += sway * math.sin(body.sway_direction)
    if body.settling_x != 0 or body.settling_y != 0:
        settling = math.exp(-t / body.settling_time)
        u, v = u + body.settling_x * settling, v + body.settling_y * settling
    shear = body.gxy - 2 * body.channel_speed * body.y / body.channel_half_width**2
    return u, v, (body.gyx - shear) / 2


@numba.njit(cache=True)
def place_force(body: Any) -> Pair:
    """Return the velocity [m/s] of a body by position-dependent forces: hot spot, trap.

    Parameters
    ----------
    body : object
        The particle, of type BODY.

    Returns
    -------
    Pair
        Velocity [m/s].
    """
    x, y, spot = body.x - body.spot_x, body.y - body.spot_y, 0.0
    if body.spot_speed != 0:
        squared = (x**2 + y**2) / body.spot_width**2
        spot = body.spot_speed / body.spot_width * math.exp((1 - squared) / 2)
    outward = -body.trap_speed * (body.x**2 + body.y**2) / body.trap_length**3
    return outward * body.x + spot * x, outward * body.y + spot * y


@numba.njit(cache=True)
def _between(x: float, last: int) -> tuple[int, float]:
    """Return the table index before a coordinate `x` [m], and the fraction to the next."""
    x = x / SPACING + last / 2
    if not x > 0:  # also true for NaN
        return 0, 0.0
    if x >= last:
        return last - 1, 1.0
    return int(x), x - int(x)


@numba.njit(cache=True)
def gradient_at(table: np.ndarray, x: float, y: float) -> tuple[float, float, float]:
    """Interpolate the gradient at `x`, `y` [m] bilinearly in a `table` of `coil_gradients`.

    Beyond the table, that at its edge.

    Parameters
    ----------
    table : ndarray
        Part of `coil_gradients`.
    x : float
        Coordinate [m].
    y : float
        Coordinate [m].

    Returns
    -------
    tuple[float, float, float]
        ∂Bx/∂x, ∂Bx/∂y and ∂By/∂y over the field [1/m].
    """
    i, x = _between(x, len(table) - 1)
    j, y = _between(y, len(table) - 1)
    a, b, c, d = (1 - x) * (1 - y), (1 - x) * y, x * (1 - y), x * y
    p, q, r, s = table[i, j], table[i, j + 1], table[i + 1, j], table[i + 1, j + 1]
    return (a * p[0] + b * q[0] + c * r[0] + d * s[0], a * p[1] + b * q[1] + c * r[1] + d * s[1],
            a * p[2] + b * q[2] + c * r[2] + d * s[2])


@numba.njit(cache=True)
def coil_force(
    table: np.ndarray, bx: float, by: float, x: float, y: float, mx: float, my: float,
) -> Pair:
    """Return (m·∇)B [N] on a moment by coils on an axis along their field.

    `mx`, `my` [A m²] is the moment, at `x`, `y` [m]; `bx`, `by` [T] the field at the centre,
    `table` a part of `coil_gradients`.

    Parameters
    ----------
    table : ndarray
        Part of `coil_gradients`.
    bx : float
        Field at the centre along x [T].
    by : float
        Field at the centre along y [T].
    x : float
        Coordinate [m].
    y : float
        Coordinate [m].
    mx : float
        Moment along x [A m²].
    my : float
        Moment along y [A m²].

    Returns
    -------
    Pair
        Force [N].
    """
    strength = math.sqrt(bx**2 + by**2)
    if strength == 0:
        return 0.0, 0.0
    c, s = bx / strength, by / strength
    xx, xy, yy = gradient_at(table, c * x + s * y, c * y - s * x)
    along, across = strength * (c * mx + s * my), strength * (c * my - s * mx)
    u, v = xx * along + xy * across, xy * along + yy * across
    return c * u - s * v, s * u + c * v


@numba.njit(cache=True)
def magnetic_velocity(body: Any, x: float, y: float, coils: np.ndarray) -> Pair:
    """Return the velocity [m/s] of a body by the gradients of its `coils` (`coil_gradients`).

    `x`, `y` [T] is the field of the coils of each axis at the centre: of a pair of coils each, or
    of one coil in the direction of that field. The moments of the body lie φ behind its heading,
    along the field that turns it.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    x : float
        Field of the coils of the x axis [T].
    y : float
        Field of the coils of the y axis [T].
    coils : ndarray
        Result of `coil_gradients`.

    Returns
    -------
    Pair
        Velocity [m/s].
    """
    if body.pair_moment == 0 and body.coil_moment == 0:
        return 0.0, 0.0
    angle = body.heading - body.phi
    mx, my = math.cos(angle), math.sin(angle)
    lean_x, lean_y = math.sin(body.skew) * y, math.cos(body.skew) * y
    u, v = coil_force(coils[0], x, 0.0, body.x, body.y, mx, my)
    du, dv = coil_force(coils[0], lean_x, lean_y, body.x, body.y, mx, my)
    u, v = body.pair_moment * (u + du), body.pair_moment * (v + dv)
    du, dv = coil_force(coils[1], x + lean_x, lean_y, body.x, body.y, mx, my)
    return u + body.coil_moment * du, v + body.coil_moment * dv


@numba.njit(cache=True)
def dipole_velocity(body: Any, other: Any, x: float, y: float, r: float) -> Pair:
    """Return the velocity [m/s] of a body by the moment of the `other` at distance `r` [m].

    The direction to it is (`x`, `y`).

    The force between point dipoles, 3µ₀m₁m₂/4πr⁴ [(m̂₁·r̂)m̂₂ + (m̂₂·r̂)m̂₁ + (m̂₁·m̂₂)r̂ −
    5(m̂₁·r̂)(m̂₂·r̂)r̂] (Jackson), over the drag: `dipole` is 3µ₀m²/4π over 6πηr [m⁵/s].

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    other : object
        The other particle, of type BODY.
    x : float
        Direction to it along x.
    y : float
        Direction to it along y.
    r : float
        Distance [m].

    Returns
    -------
    Pair
        Velocity [m/s].
    """
    mine, others = body.heading - body.phi, other.heading - other.phi
    ax, ay, bx, by = math.cos(mine), math.sin(mine), math.cos(others), math.sin(others)
    a, b = ax * x + ay * y, bx * x + by * y
    radial = ax * bx + ay * by - 5 * a * b
    scale = math.sqrt(abs(body.dipole * other.dipole)) / r**4
    return scale * (a * bx + b * ax + radial * x), scale * (a * by + b * ay + radial * y)


@numba.njit(cache=True)
def neighbours(bodies: np.ndarray, i: int) -> tuple[float, float, float]:
    """Return the velocity [m/s] of body `i` by all other `bodies`, and the factor on its speed.

    Parameters
    ----------
    bodies : ndarray, shape (N,)
        BODY of each particle.
    i : int
        Row of the particle.

    Returns
    -------
    tuple[float, float, float]
        Velocity along x and y [m/s], and the factor.
    """
    body, u, v, slowing = bodies[i], 0.0, 0.0, 0.0
    felt = body.dipole != 0 or body.repulsion_speed != 0 or body.crowding != 0
    for j in range(len(bodies)):
        other = bodies[j]
        if j == i or not (felt or other.pusher != 0 or other.stir != 0):
            continue
        x, y = body.x - other.x, body.y - other.y
        r = max(math.sqrt(x**2 + y**2), 1e-9)
        x, y = x / r, y / r
        away = 0.0
        if body.dipole != 0:
            du, dv = dipole_velocity(body, other, x, y, r)
            u, v = u + du, v + dv
        if body.repulsion_speed != 0:
            away += body.repulsion_speed * math.exp(-r / body.repulsion_range)
        if other.pusher != 0:
            along = x * math.cos(other.heading) + y * math.sin(other.heading)
            away += other.pusher * (3 * along**2 - 1) / r**2
        if other.stir != 0:
            along = x * math.cos(other.heading) + y * math.sin(other.heading)
            away += other.stir * roll_frequency(other, other.turns) * along / r**3
        u, v = u + away * x, v + away * y
        slowing += body.crowding / r
    return u, v, max(1 - slowing, 0.0)


@numba.njit(cache=True)
def rotate(body: Any, bx: float, by: float, vorticity: float, t: float, dt: float,
           normal: float) -> None:
    """Turn a body for `dt` [s] about `t` [s], in place.

    Causes are torque against drag, fluid, chirality and noise. Field `bx`, `by` [T]; `vorticity`,
    the rotation of the fluid [rad/s]; `normal`, a standard normal number.

    Parameters
    ----------
    body : object
        The particle, of type BODY.
    bx : float
        Field along x [T].
    by : float
        Field along y [T].
    vorticity : float
        Rotation of the fluid [rad/s].
    t : float
        Time [s].
    dt : float
        Duration [s].
    normal : float
        A standard normal number.
    """
    body.phi += body.slip_rate * dt
    strength = math.sqrt(bx**2 + by**2)
    target = math.atan2(by, bx) + body.phi
    if body.wobble_angle != 0:
        target += body.wobble_angle * math.sin(2 * math.pi * body.wobble_frequency * t)
    rate = body.moment * strength / body.turn_drag
    body.heading = step_heading(body.heading, target, rate, body.rotational_diffusion, dt, normal)
    body.heading += (vorticity + body.spin) * dt


@numba.njit(cache=True)
def advance(
    bodies: np.ndarray, middle: np.ndarray, length: float, rows: np.ndarray, field: np.ndarray,
    frequency: np.ndarray, coils: np.ndarray, half_extent: np.ndarray, walls: np.ndarray,
    rng: np.random.Generator, mean: np.ndarray, touched: np.ndarray,
) -> None:
    """Move all bodies through steps of `length` [s] about the times `middle`, in place.

    Parameters
    ----------
    bodies : (N,) array of BODY
        Particles, changed in place.
    middle : (K,) array [s]
        Middle of each step.
    length : float [s]
        Duration of a step.
    rows : (R,) array [s]
        Start of each row of `field` and `frequency`.
    field : (R, 1 or N, 2) array [T]
        Field of each row.
    frequency : (R, 1 or N) array [Hz]
        Frequency of a rotating field of each row.
    coils : array
        As `coil_gradients`.
    half_extent : (2,) array [m]
        Walls at ± this.
    walls : (W, 4) array [m]
        Straight walls from x, y to x, y.
    rng : Generator
        Source of random numbers.
    mean : (N, 2) array [m]
        The average position is added to it.
    touched : (N,) bool array
        Set for bodies that touch another or one of the `walls`.
    """
    velocity = np.empty((len(bodies), 2))
    here = np.zeros(2)
    for t in middle:
        for i in range(len(bodies)):
            body = bodies[i]
            row = np.searchsorted(rows, t - body.delay, side='right') - 1
            turns = 0.0
            here[:] = 0.0
            if row >= 0:
                here[:] = field[row, min(i, field.shape[1] - 1)]
                turns = frequency[row, min(i, frequency.shape[1] - 1)]
            _move(bodies, i, here, turns, t, length, coils, rng, velocity)
        for i in range(len(bodies)):
            _displace(bodies[i], velocity[i], length, rng, half_extent, mean[i])
        _separate(bodies, touched)
        _keep_out(bodies, walls, touched)
    mean /= len(middle)


@numba.njit(cache=True)
def advance_worlds(
    bodies: np.ndarray, which: np.ndarray, start: np.ndarray, duration: float, steps: int,
    rows: np.ndarray, field: np.ndarray, count: np.ndarray, coils: np.ndarray,
    rng: np.random.Generator, mean: np.ndarray,
) -> None:
    """Move the worlds `which` of `bodies` by `duration` in equal steps, in place.

    Parameters
    ----------
    bodies : (M, N) array of BODY
        Particles of each world, changed in place.
    which : (K,) int array
        Indices of the worlds that move.
    start : (M,) array [s]
        Present time of each world.
    duration : float [s]
        Time by which they move.
    steps : int
        Number of equal steps.
    rows : (R,) array [s]
        Start of each command.
    field : (M, R, 1, 2) array [T]
        Field of each command.
    count : (M,) int array
        Number of commands so far.
    coils : array
        As `coil_gradients`.
    rng : Generator
        Source of random numbers.
    mean : (M, N, 2) array [m]
        The average position is added to it.
    """
    half_extent, walls = np.full(2, np.inf), np.empty((0, 4))
    touched = np.zeros(bodies.shape[1], np.bool_)
    middle = (np.arange(steps) + 0.5) * (duration / steps)
    for m in which:
        had = count[m]
        advance(bodies[m], start[m] + middle, duration / steps, rows[:had], field[m, :had],
                np.zeros((had, 1)), coils, half_extent, walls, rng, mean[m], touched)


@numba.njit(cache=True)
def _move(
    bodies: np.ndarray, i: int, command: np.ndarray, turns: float, t: float, length: float,
    coils: np.ndarray, rng: np.random.Generator, velocity: np.ndarray,
) -> None:
    """Turn one particle and record the velocity by all causes together."""
    body = bodies[i]
    x, y = coil_fields(body, command[0], command[1])
    bx, by = felt_field(body, x, y)
    strength = math.sqrt(bx**2 + by**2)
    u, v, vorticity = flow(body, t)
    du, dv = place_force(body)
    gu, gv = magnetic_velocity(body, x, y, coils)
    pu, pv, slowing = neighbours(bodies, i)
    before = body.heading
    rotate(body, bx, by, vorticity, t, length, rng.standard_normal())
    during = (before + body.heading) / 2
    body.turns = turns
    speed = own_speed(body, turns, t) * slowing
    along, across = tilt(body, strength, rng)
    c, s = math.cos(during), math.sin(during)
    velocity[i, 0] = u + du + gu + pu + speed * (along * c - across * s)
    velocity[i, 1] = v + dv + gv + pv + speed * (along * s + across * c)


@numba.njit(cache=True)
def _displace(
    body: Any, velocity: np.ndarray, length: float, rng: np.random.Generator,
    half_extent: np.ndarray, mean: np.ndarray,
) -> None:
    spread = math.sqrt(2 * body.diffusion * length)
    x, y = body.x, body.y
    x += velocity[0] * length + spread * rng.standard_normal()
    y += velocity[1] * length + spread * rng.standard_normal()
    x = min(max(x, -half_extent[0]), half_extent[0])
    y = min(max(y, -half_extent[1]), half_extent[1])
    mean[0] += (body.x + x) / 2
    mean[1] += (body.y + y) / 2
    body.x, body.y = x, y
    body.fuel *= math.exp(-length / body.fuel_time)


@numba.njit(cache=True)
def _separate(bodies: np.ndarray, touched: np.ndarray) -> None:
    """Push overlapping spheres apart along their line of centres, and note both in `touched`.

    A force that moves one moves the other in proportion to their mobilities.
    """
    for i in range(len(bodies)):
        for j in range(i):
            a, b = bodies[i], bodies[j]
            x, y = a.x - b.x, a.y - b.y
            contact = a.radius + b.radius
            squared = x**2 + y**2
            if 0 < squared < contact**2:
                push = contact / math.sqrt(squared) - 1
                mine = push * b.drag / (a.drag + b.drag)
                a.x, a.y = a.x + mine * x, a.y + mine * y
                b.x, b.y = b.x - (push - mine) * x, b.y - (push - mine) * y
                touched[i] = touched[j] = True


@numba.njit(cache=True)
def _keep_out(bodies: np.ndarray, walls: np.ndarray, touched: np.ndarray) -> None:
    """Push spheres off thin walls, and note them in `touched`."""
    for wall in walls:
        along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
        for i in range(len(bodies)):
            body = bodies[i]
            x, y = body.x - wall[0], body.y - wall[1]
            part = (x * along_x + y * along_y) / (along_x**2 + along_y**2)
            part = min(max(part, 0.0), 1.0)
            x, y = x - part * along_x, y - part * along_y
            away = math.sqrt(x**2 + y**2)
            if 0 < away < body.radius:
                push = body.radius / away - 1
                body.x, body.y = body.x + push * x, body.y + push * y
                touched[i] = True
