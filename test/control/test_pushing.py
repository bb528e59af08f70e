"""A bead that a roller pushes: along a line, round a bend, and after it has slipped off."""

import math

import numpy as np
import pytest

from bench._rolling_loop import Rollers, RollingLoop
from microbot_ros.control.contract import ModelError, ParticleLostError
from microbot_ros.control.plugins.pushing import Pushing, PushingParameters
from microbot_ros.control.testkit import controller_input
from microbot_ros.model.model import Model

ALONG = np.linspace(0, 1, 61)
BEND = 1e-6 * np.column_stack((60 * ALONG, 12 * np.sin(math.tau * ALONG)))
PAIR = Rollers(np.array([3e-6, 0.0]), np.array([0.4, 0.0]), np.array([20.0, 0.0]),
               np.full(2, 2.3e-6))


def pushed(start_um, seed=0):
    """Where the bead was (K, 2) [m], with the roller at first at some place."""
    loop = RollingLoop(PAIR, np.array([1e-6 * np.array(start_um), BEND[0]]), seed)
    controller = Pushing()
    controller.configure(PushingParameters(particle=1))
    places, done = [], []

    def note(_, outcome):
        places.append(loop.world.position[1])
        done.append(outcome.command.progress.done)
        return done[-1]

    loop.run(controller, 60.0, note, path=BEND)
    return np.array(places), done[-1]


@pytest.mark.parametrize('start_um', [(-10, 0), (8, 8), (12, 0)])
def test_the_bead_goes_along_the_path_wherever_the_roller_begins(start_um):
    places, done = pushed(start_um)
    off = np.hypot(*(places[:, None] - BEND).T).min(0)
    assert done
    assert off.mean() < 2.5e-6
    assert np.hypot(*(places[-1] - BEND[-1])) < 3e-6


def test_a_bead_that_nobody_pushes_stays():
    loop = RollingLoop(PAIR, np.array([[4e-5, 0], BEND[0]]), 0)
    controller = Pushing()
    loop.run(controller, 5.0, lambda *_: False)
    assert np.hypot(*loop.world.position[1]) < 3e-6


def test_the_push_leans_against_what_turns_it_and_goes_round_where_it_slipped_off():
    controller = Pushing()
    heading, _, what = controller._move(5e-6 * np.exp(1j * (math.pi + 0.2)), 0.0)
    assert what == 'pushes'
    assert heading == pytest.approx(0.2 + 1.5 * 0.2)
    heading, _, what = controller._move(5e-6 + 0j, 0.0)  # in front of the bead
    assert what == 'goes round'
    assert abs(math.remainder(heading, math.tau)) < math.pi / 2  # away from it, not through it


def test_it_asks_for_rollers_and_for_somebody_who_pushes():
    with pytest.raises(ModelError, match='propulsion: rolling'):
        Pushing().activate(controller_input())
    alone = controller_input(1, model=Model(5e-3, 'rolling'), path=BEND)
    with pytest.raises(ParticleLostError, match='no other particle'):
        Pushing().compute(alone)
    controller = Pushing()
    with pytest.raises(ValueError, match='round_um must be more'):
        controller.configure(PushingParameters(round_um=4.0))
