"""Increments for fitting: the same physics as the simulation, linear in v and φ, honest gaps."""

import numpy as np
import pytest

from microbot_ros.common.records import Commands
from microbot_ros.model.effects.field.background_field import BackgroundField
from microbot_ros.model.effects.field.command_delay import CommandDelay
from microbot_ros.model.effects.heading.alignment_lag import AlignmentLag
from microbot_ros.model.effects.observation.pixel_anisotropy import PixelAnisotropy
from microbot_ros.model.effects.velocity.hot_spot import HotSpot
from microbot_ros.model.effects.velocity.linear_flow import LinearFlow
from microbot_ros.model.effects.velocity.speed_decay import SpeedDecay
from microbot_ros.model.first_order import simulate
from microbot_ros.model.increments import heading_response, respond
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.timeline import Timeline

B = 2e-3
RNG = np.random.default_rng(3)
ANGLE = RNG.uniform(-np.pi, np.pi, 9)
COMMANDS = Commands(
    np.arange(9) * 0.93 - 2.0, B * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1),
    RNG.uniform(1, 9, 9))
TIMES = np.arange(150) / 30
PARTICLES = ParticleParameters(np.arange(3), np.array([3e-6, 4e-6, 5e-6]), np.array([-1, 2, 0.5]))
START = np.array([[0.0, 0.0], [1e-5, 0.0], [0.0, 2e-5]])

MODELS = {
    'baseline': Model(B),
    'rolling': Model(B, 'rolling', (SpeedDecay(20.0),)),
    'lag': Model(B, effects=(AlignmentLag(0.3), BackgroundField(1e-4, 2e-4))),
    'camera': Model(B, effects=(CommandDelay(0.11), PixelAnisotropy(1.1))),
    'vortex': Model(B, effects=(LinearFlow(0.0, -0.02, 0.02, 0.0), PixelAnisotropy(1.2))),
    'many': Model(B, effects=(
        BackgroundField(2e-4, 0.0), HotSpot(1e-5, 0.0, 3e-6, 8e-6),
        LinearFlow(0.0, -0.02, 0.02, 0.0), SpeedDecay(20.0))),
    'many in another field': Model(B, effects=(
        BackgroundField(-2e-4, 0.0), HotSpot(1e-5, 0.0, 3e-6, 8e-6),
        LinearFlow(0.0, -0.02, 0.02, 0.0), SpeedDecay(20.0))),
    'lag at another field': Model(2 * B, effects=(
        AlignmentLag(0.3), BackgroundField(1e-4, 2e-4))),
    'place': Model(B, effects=(HotSpot(1e-5, 0.0, 3e-6, 8e-6), PixelAnisotropy(0.9))),
}
every_model = pytest.mark.parametrize('model', MODELS.values(), ids=MODELS)


def prepared(model: Model) -> tuple[np.ndarray, Timeline]:
    """Simulated measured positions, and the timeline that has them as covariates."""
    seen = model.observe(simulate(model, PARTICLES, COMMANDS, TIMES, START))
    return seen, Timeline(COMMANDS, TIMES, seen)


@every_model
def test_increments_are_those_of_the_simulation(model):
    seen, timeline = prepared(model)
    # Where velocity depends on place it is taken where the interval begins.
    tolerance = 2e-3 * 1e-6 if model.needs_position else 1e-18
    np.testing.assert_allclose(
        respond(model, timeline).increments(PARTICLES), np.diff(seen, axis=0), atol=tolerance)


@every_model
def test_increments_are_linear_in_v_and_phi(model):
    _, timeline = prepared(model)
    response = respond(model, timeline)
    c = PARTICLES.velocity_phasor
    ab = np.stack([c.real, c.imag], axis=-1)
    linear = np.einsum('tixk,ik->tix', np.broadcast_to(
        response.columns(), (len(TIMES) - 1, 3, 2, 2)), ab) + response.offset()
    np.testing.assert_allclose(linear, response.increments(PARTICLES), rtol=1e-12, atol=1e-20)


@every_model
def test_a_prepared_timeline_answers_as_a_fresh_one(model):
    seen, timeline = prepared(model)
    for other in MODELS.values():
        respond(other, timeline)
    np.testing.assert_array_equal(
        respond(model, timeline).increments(PARTICLES),
        respond(model, Timeline(COMMANDS, TIMES, seen)).increments(PARTICLES))


def test_a_block_from_the_middle_remembers_the_commands_before_it():
    model = MODELS['lag']
    whole = respond(model, Timeline(COMMANDS, TIMES)).increments(PARTICLES)
    block = respond(model, Timeline(COMMANDS, TIMES[60:])).increments(PARTICLES)
    np.testing.assert_allclose(block, whole[60:], rtol=1e-9, atol=1e-18)


def test_a_turned_heading_is_felt_as_the_sensitivity_says():
    model = Model(B, effects=(AlignmentLag(0.3), PixelAnisotropy(1.1), SpeedDecay(30.0)))
    felt = heading_response(model, PARTICLES, Timeline(COMMANDS, TIMES))
    for k in (5, 23, 51, 77):  # switches fall into the middle two
        theta = felt.theta[k]
        later = Timeline(COMMANDS, TIMES[k:k + 2])
        ends = [respond(model, later, np.exp(1j * (theta + turn - PARTICLES.phi)))
                for turn in (1e-5, -1e-5)]
        slope = (ends[0].increments(PARTICLES) - ends[1].increments(PARTICLES))[0] / 2e-5
        np.testing.assert_allclose(felt.heading_sensitivity[k], slope, rtol=1e-6, atol=1e-14)
        turned = np.angle(ends[0].heading[-1] / ends[1].heading[-1]) / 2e-5
        np.testing.assert_allclose(felt.heading_retention[k], turned, rtol=1e-6)


def test_alignment_at_once_forgets_a_turned_heading_and_no_field_keeps_it():
    field = np.array([[B, 0.0], [0.0, 0.0]])
    timeline = Timeline(Commands(np.array([0.0, 1.0]), field), np.array([0.0, 0.5, 1.0, 1.5, 2.0]))
    felt = heading_response(Model(B), PARTICLES, timeline)
    np.testing.assert_array_equal(felt.heading_retention[:, 0], [0, 0, 1, 1])
    np.testing.assert_allclose(felt.heading_sensitivity[3] @ [1, 1j],
                               0.5j * PARTICLES.velocity_phasor, rtol=1e-12)
    np.testing.assert_array_equal(felt.heading_sensitivity[:2], 0)


def test_a_pause_of_an_hour_is_not_divided_into_36_000_spans():
    """In which the heading aligns to the command as it does in a pause of a minute."""
    model = Model(B, effects=(AlignmentLag(0.3), SpeedDecay(20.0)))
    ends = []
    for pause in (60.0, 3600.0):
        times = np.where(TIMES > 1.0, TIMES + pause, TIMES)
        commands = Commands(np.array([0.0, 1.0]), np.array([[B, 0.0], [0.0, B]]))
        timeline = Timeline(commands, times)
        assert len(timeline.segments(model).t) < 2 * len(TIMES) + 310
        ends.append(respond(Model(B, effects=(AlignmentLag(0.3),)), timeline).increments(
            PARTICLES)[-1])
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-6)


@pytest.mark.parametrize('model', [MODELS['many'], Model(B, effects=(
    AlignmentLag(0.3), SpeedDecay(20.0)))])
def test_a_command_of_a_month_ago_is_as_one_of_a_minute_ago(model):
    """And is not divided into millions of spans."""
    month, minute = (Commands(
        np.append(-begin, COMMANDS.t[3:]), np.vstack([[B, 0.0], COMMANDS.field[3:]]))
        for begin in (3e6, 60.0))
    long, short = (Timeline(commands, TIMES, np.zeros((len(TIMES), 3, 2)))
                   for commands in (month, minute))
    assert len(long.segments(model).t) == len(short.segments(model).t)
    np.testing.assert_allclose(
        respond(model, long).propulsion, respond(model, short).propulsion, rtol=1e-6)


def test_a_heading_is_unknown_before_the_first_command():
    late = Commands(np.array([1.0]), np.array([[B, 0.0]]))
    timeline = Timeline(late, np.array([0.0, 0.5, 1.0, 1.5]))
    for model in (Model(B), MODELS['lag'].without('background_field')):
        felt = heading_response(model, PARTICLES, timeline)
        assert np.isnan(felt.theta[:2]).all()
        np.testing.assert_allclose(felt.theta[2:], [PARTICLES.phi] * 2)
        np.testing.assert_array_equal(respond(model, timeline).increments(PARTICLES)[:2], 0.0)
