"""The drive response on known shapes of rollers and on a real recording of one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import least_squares

from microbot_ros.common.records import Commands
from microbot_ros.model.effects.velocity.drive_response import DriveResponse, hill
from microbot_ros.model.increments import respond
from microbot_ros.model.model import Model
from microbot_ros.model.timeline import Timeline

FREQUENCY = np.geomspace(0.3, 40.0, 60)
STARTS = DriveResponse.starts(SimpleNamespace(frequencies=FREQUENCY))


def response(effect: DriveResponse, f: np.ndarray) -> np.ndarray:
    gains = hill(f, effect.cut_in, effect.cut_in_steepness)
    return gains * (1 - effect.slip * hill(f, effect.step_out, effect.step_out_steepness))


def best_fit(residuals) -> tuple[DriveResponse, float]:
    """From every start, by the effect's own coordinates and bounds; with the least squares."""
    low, high = np.array([p.fit_bounds for p in DriveResponse.parameters()]).T
    found = []
    for start in STARTS:
        model = Model(1e-3, 'rolling', (start,))
        begin = np.clip(model.vector(), low + 1e-6, high - 1e-6)
        fit = least_squares(lambda x, m=model: residuals(m.with_vector(x).effects[0]), begin,
                            bounds=(low, high))
        found.append((fit.cost, model.with_vector(fit.x).effects[0]))
    cost, effect = min(found, key=lambda pair: pair[0])
    return effect, 2 * cost


SHAPES = {
    'static friction': lambda f: np.sqrt(np.maximum(1 - (1.1 / f) ** 2, 0.0)),
    'dead zone': lambda f: np.maximum(f - 1.0, 0.0) / f,
    'threshold': lambda f: (f > 1.1) * 1.0,
    'slip beyond a corner': lambda f: np.where(f < 10, 1.0, 0.65),
    'rotor beyond step-out': lambda f: 1 - np.sqrt(1 - np.minimum(8.0 / f, 1.0) ** 2),
    'saturation': lambda f: 1 / (1 + f / 15.0),
}


@pytest.mark.parametrize('shape', SHAPES.values(), ids=SHAPES)
def test_the_known_shapes_of_rollers_can_be_described(shape):
    truth = shape(FREQUENCY)

    def residuals(effect):
        r = response(effect, FREQUENCY)
        return r * (r @ truth) / max(r @ r, 1e-12) - truth

    _, left = best_fit(residuals)
    proportional = np.sum((truth - truth.mean()) ** 2)
    assert left < 0.05 * proportional


def test_the_ends_of_the_response():
    f = np.array([0.0, 1e-9, 2.0, 1e9])
    np.testing.assert_allclose(hill(f, 2.0, 3.0), [0, 0, 0.5, 1], atol=1e-12)
    np.testing.assert_array_equal(hill(f, 0.0, 3.0), 1.0)


def test_a_recorded_roller_is_described(recordings):
    """Its gain is near 4.2 µm/s/Hz up to 8 Hz and 2.5 to 3.4 from 11 Hz on, by its own levels."""
    folder = recordings / 'rolling_robot'
    tracks = np.genfromtxt(folder / 'tracks.csv', delimiter=',', names=True)
    rows = np.genfromtxt(folder / 'commands.csv', delimiter=',', names=True)
    angle, f = rows['direction_rad'], rows['frequency_hz']
    field = 1e-3 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    timeline = Timeline(Commands(rows['t_s'], field, f), tracks['t_s'])
    moved = np.diff(np.stack([tracks['x_um'], tracks['y_um']], axis=1), axis=0)
    sound = np.hypot(*moved.T) < 25  # the track jumps where the stage was moved

    def residuals(effect: DriveResponse | None) -> np.ndarray:
        model = Model(1e-3, 'rolling', () if effect is None else (effect,))
        columns = respond(model, timeline).columns()[sound, 0].reshape(-1, 2)
        y = moved[sound].ravel()
        return y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]

    before = residuals(None)
    effect, left = best_fit(residuals)
    assert len(before) * np.log(before @ before / left) > 150
    assert 8.0 < effect.step_out < 11.0
    assert 0.3 < effect.slip < 0.55
    assert 0.3 < effect.cut_in < 3.0
    ratio = response(effect, np.array([6.0])) / response(effect, np.array([13.0]))
    assert 1.3 < ratio[0] < 1.7


def test_a_particle_follows_before_it_loses_the_field():
    crossed = DriveResponse(cut_in=15.0, slip=0.5, step_out=2.0)
    context = SimpleNamespace(frequency=FREQUENCY)
    np.testing.assert_array_equal(
        crossed.speed_factor(context), replace(crossed, cut_in=2.0).speed_factor(context))
