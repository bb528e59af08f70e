"""`model.yaml`: exact both ways, and errors that name what is wrong and what is known."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from microbot_ros.common.errors import InputError
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.effects.velocity.uniform_drift import UniformDrift
from microbot_ros.model.io.model_file import read_model, write_model
from microbot_ros.model.model import Model, ParticleParameters

GOLDEN = """\
propulsion: catalytic
reference_field_mT: 2.0
particles:
- id: 0
  v_um_s: 3.71
  phi_rad: -1.09
- id: 3
  v_um_s: 4.38
  phi_rad: 3.82
effects:
  alignment_lag:
    tau_s: 0.15
  uniform_drift:
    wx_um_s: 0.41
    wy_um_s: -1.0e-9
"""


def test_a_file_is_read_in_si_and_written_back_to_the_byte(tmp_path):
    (tmp_path / 'in.yaml').write_text(GOLDEN)
    model, particles = read_model(tmp_path / 'in.yaml')
    assert model.reference_field == 2e-3
    assert model.effect('uniform_drift') == UniformDrift(0.41e-6, -1e-15)
    np.testing.assert_array_equal(particles.ids, [0, 3])
    np.testing.assert_array_equal(particles.speed, [3.71e-6, 4.38e-6])
    np.testing.assert_array_equal(particles.phi, [-1.09, 3.82])
    write_model(tmp_path / 'out.yaml', model, particles)
    assert (tmp_path / 'out.yaml').read_text() == GOLDEN


@st.composite
def models(draw):
    chosen = draw(st.lists(st.sampled_from(list(EFFECTS.values())), unique=True, max_size=5))
    effects = tuple(
        effect(**{p.field: draw(st.floats(p.low, p.high)) for p in effect.parameters()})
        for effect in chosen
    )
    propulsion = draw(st.sampled_from(['catalytic', 'rolling']))
    return Model(draw(st.floats(1e-6, 1.0)), propulsion, effects)


@settings(max_examples=60)
@given(model=models(), numbers=st.lists(
    st.tuples(st.floats(-1e-3, 1e-3), st.floats(-10, 10)), max_size=4))
def test_any_model_comes_back_to_the_last_bit(tmp_path_factory, model, numbers):
    path = tmp_path_factory.mktemp('model') / 'model.yaml'
    speed, phi = np.reshape(np.array(numbers, dtype=float), (-1, 2)).T
    write_model(path, model, ParticleParameters(np.arange(len(numbers)), speed, phi))
    again, particles = read_model(path)
    assert again == model
    np.testing.assert_array_equal(particles.speed, speed)
    np.testing.assert_array_equal(particles.phi, phi)


BASE = """\
reference_field_mT: 2
particles:
  - {id: 0, v_um_s: 3, phi_rad: 0.1}
effects:
  command_delay:
    delay_s: 0.1
"""


@pytest.mark.parametrize(('more', 'line', 'message'), [
    ('  uniform_drif: {wx_um_s: 1}', 7, r'uniform_drif.*unknown effect.*uniform_drift'),
    ('  uniform_drift: {wx_um_s: 1, wy: 3}', 7, r'uniform_drift\.wy.*known are wx_um_s, wy_um_s'),
    ('  uniform_drift: {wx_um_s: 1, wy_m_s: 3}', 7, r'wy_m_s.*known are wx_um_s, wy_um_s'),
    ('  uniform_drift: {wx_um_s: 1}', 7, r"expected a key 'effects\.uniform_drift\.wy_um_s'"),
    ('  uniform_drift:\n    wx_um_s: fast\n    wy_um_s: 0', 8, r'wx_um_s.*number'),
    ('  uniform_drift:\n    wx_um_s: .nan\n    wy_um_s: 0', 8, r'wx_um_s.*finite'),
    ('  uniform_drift:\n    wx_um_s: .inf\n    wy_um_s: 0', 8, r'wx_um_s.*finite'),
    ('  uniform_drift:\n    wx_um_s: -.inf\n    wy_um_s: 0', 8, r'wx_um_s.*finite'),
    ('  speed_decay: {tau_s: .nan}', 7, r'speed_decay\.tau_s'),
    ('  speed_decay: {tau_s: -.inf}', 7, r'speed_decay\.tau_s'),
    ('  alignment_lag: {tau_s: -0.1}', 7, r'tau_s.*greater than or equal to 0'),
    ('  uniform_drift:', 7, r'uniform_drift.*mapping'),
    ('  uniform_drift: 3', 7, r'uniform_drift.*mapping'),
])
def test_a_bad_effect_is_named_with_its_line(tmp_path, more, line, message):
    path = tmp_path / 'model.yaml'
    path.write_text(BASE + more + '\n')
    with pytest.raises(InputError, match=message) as caught:
        read_model(path)
    assert caught.value.line == line


@pytest.mark.parametrize('name', EFFECTS)
def test_every_limit_holds_and_nothing_beyond_it_is_read(tmp_path, name):
    path = tmp_path / 'model.yaml'
    nobody = ParticleParameters(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    null = EFFECTS[name].null()
    for p in null.parameters():
        for limit, beyond in ((p.low, -1e-9 * p.scale), (p.high, 1e-9 * p.scale)):
            inside = Model(1e-3, effects=(dataclasses.replace(null, **{p.field: limit}),))
            write_model(path, inside, nobody)
            assert read_model(path)[0] == inside
            for value in (limit + beyond, np.nan) if np.isfinite(limit) else (np.nan,):
                effect = dataclasses.replace(null, **{p.field: value})
                with pytest.raises(ValueError, match=p.name):
                    write_model(path, Model(1e-3, effects=(effect,)), nobody)


@pytest.mark.parametrize(('text', 'message'), [
    (BASE.replace('mT: 2', 'mT: 0'), 'reference_field_mT.*greater than 0'),
    (BASE.replace('mT: 2', 'mT: .nan'), 'reference_field_mT'),
    (BASE.replace('reference_field_mT: 2\n', ''), "expected a key 'reference_field_mT'"),
    (BASE.replace('v_um_s: 3, ', ''), "expected 'v_um_s' of each catalytic particle"),
    (BASE.replace('v_um_s', 'gain_um_s_hz'), "expected 'v_um_s' of each catalytic particle"),
    ('propulsion: rolling\n' + BASE, "expected 'gain_um_s_hz' of each rolling particle"),
    ('propulsion: flying\n' + BASE, 'propulsion.*one of: catalytic, rolling'),
    (BASE.replace('id: 0', 'id: 0.5'), r'particles\.0\.id.*whole number'),
    (BASE.replace('phi_rad: 0.1}', 'phi_rad: 0.1}\n  - {id: 0, v_um_s: 1, phi_rad: 0}'),
     'different ids'),
    ('effects: [\n', 'YAML'),
])
def test_a_bad_file_is_an_input_error(tmp_path, text, message):
    path = tmp_path / 'model.yaml'
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_model(path)


def test_a_missing_file_is_an_input_error():
    with pytest.raises(InputError, match='readable'):
        read_model(Path('no/such/model.yaml'))


def test_fuel_that_lasts_for_ever_is_infinity(tmp_path):
    path = tmp_path / 'model.yaml'
    nobody = ParticleParameters(np.zeros(0, dtype=int), np.zeros(0), np.zeros(0))
    write_model(path, Model(1e-3, effects=(SpeedDecay(np.inf),)), nobody)
    assert 'tau_s: .inf' in path.read_text()
    assert read_model(path)[0].effects == (SpeedDecay(np.inf),)


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf, 1.0])
def test_what_could_not_be_read_back_is_not_written(tmp_path, value):
    path = tmp_path / 'model.yaml'
    one = ParticleParameters(np.array([0]), np.array([1e-6]), np.array([0.0]))
    with pytest.raises(ValueError, match='bx_mT'):
        write_model(path, Model(1e-3, effects=(BackgroundField(value, 0.0),)), one)
    if not np.isfinite(value):
        bad = ParticleParameters(np.array([0]), np.array([value]), np.array([0.0]))
        with pytest.raises(ValueError, match='v_um_s'):
            write_model(path, Model(1e-3), bad)
    assert not list(tmp_path.iterdir())
