"""The model stage: particles and fields as they come, to estimates."""

import math

import numpy as np
import pytest

from microbot_ros.loop.model import ModelParameters, ModelStage
from microbot_ros.loop.points import particles_at

RATE, SPEED, FIELD = 20.0, 4e-6, 5e-3


def stage_with(tmp_path, effect):
    stage = ModelStage(ModelParameters())
    if effect:
        file = tmp_path / 'model.yaml'
        file.write_text(f'reference_field_mT: 5.0\neffects: {{{effect}}}\n')
        stage.use(str(file))
    return stage


def play(stage, begin, frames, immobile=False, slowing=math.inf):
    """Let a particle swim from `begin` [s] on, beside one that is always seen in one place."""
    rng, place = np.random.default_rng(0), 0j
    for k in range(frames):
        t, angle = begin + k / RATE, (k // 40) * 1.1
        if k % 40 == 0:
            stage.field(t, FIELD * np.array([math.cos(angle), math.sin(angle)]))
        speed = SPEED * math.exp(-k / RATE / slowing)
        place += speed * np.exp(1j * angle) / RATE + 9e-8 * (rng.normal() + 1j * rng.normal())
        places = [[place.real, place.imag]] + [[30e-6, 0.0]] * immobile
        stage.step(particles_at(np.arange(len(places)), np.array(places), 5e-8), t)
    return stage.estimates


@pytest.mark.parametrize('effect', [
    'speed_decay: {tau_s: 100}', 'hot_spot: {x_um: 0, y_um: 0, speed_um_s: 1, width_um: 20}'])
def test_frames_before_the_first_command_are_taken(tmp_path, effect):
    stage = stage_with(tmp_path, effect)
    for k in range(3):
        stage.step(particles_at(np.arange(1), np.zeros((1, 2)), 1e-7), 100 + k / RATE)
    assert stage.estimates.id.tolist() == [0]


def test_a_particle_seen_in_exactly_one_place_harms_no_other(tmp_path):
    found = play(stage_with(tmp_path, ''), 100.0, 400, immobile=True)
    assert found.speed[0] == pytest.approx(SPEED, rel=0.1)


def test_after_the_clock_was_set_back_effects_of_time_begin_anew(tmp_path):
    stage = stage_with(tmp_path, 'speed_decay: {tau_s: 60}')
    play(stage, 1.7e9, 300, slowing=60.0)
    found = play(stage, 0.0, 600, slowing=60.0)
    assert found.speed[0] == pytest.approx(SPEED * math.exp(-0.5), rel=0.1)
