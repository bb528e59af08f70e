"""What the drift compensator knows of its particle: from the start, along the way, after a gap."""

import cmath

import numpy as np
import pytest

from microbot_ros.control.field_record import FieldRecord
from microbot_ros.control.steering.drift_compensator import DriftCompensator
from microbot_ros.control.testkit import controller_input

ANSWER, DRIFT, DT = cmath.rect(4e-6, 2.2), 0.4e-6 - 0.3e-6j, 1 / 60
UNKNOWN = {'speed': np.array([np.nan]), 'phi': np.array([np.nan]),
           'speed_std': np.array([np.inf]), 'phi_std': np.array([np.inf])}


class World:
    """One particle, dp/dt = c u + w, whose field goes round once in six seconds."""

    def __init__(self, rolling=False):
        self.rng, self.t, self.place = np.random.default_rng(0), 0.0, 0j
        self.record, self.frequency = FieldRecord(), 3.0 if rolling else 1.0
        self.compensator = DriftCompensator(rolling)

    def go(self, seconds, noted=True):
        for _ in range(round(seconds / DT)):
            u = cmath.exp(1j * self.t * 2 * np.pi / 6)
            if noted:
                self.record.note(self.t, np.array([u.real, u.imag]) * 1e-3, self.frequency)
            self.place += (ANSWER * self.frequency * u + DRIFT) * DT
            self.t += DT

    def look(self, **known):
        seen = np.array([[self.place.real, self.place.imag]]) + self.rng.normal(0, 5e-8, (1, 2))
        return self.compensator.look(controller_input(
            1, t=self.t, age=0.0, delay=0.0, position=seen, record=self.record, **known), 0)

    def watch(self, seconds, **known):
        for _ in range(round(seconds / DT)):
            self.go(DT)
            self.look(**known)


@pytest.mark.parametrize('rolling', [False, True])
def test_learns_answer_and_drift_from_nothing(rolling):
    world = World(rolling)
    world.look(**UNKNOWN)
    assert not world.compensator.ready
    world.watch(12, **UNKNOWN)
    assert world.compensator.ready
    assert abs(world.compensator.answer - ANSWER) < 0.3e-6
    assert abs(world.compensator.drift - DRIFT) < 0.4e-6


def test_is_ready_at_once_where_others_know():
    world = World()
    world.look(speed=np.array([4e-6]), phi=np.array([2.2]))
    assert world.compensator.ready
    assert world.compensator.answer == pytest.approx(ANSWER)


def test_a_gap_in_which_the_field_is_not_known_teaches_nothing():
    world = World()
    world.watch(12, **UNKNOWN)
    before = world.compensator.answer, world.compensator.drift
    world.record.clear()
    world.go(2.0, noted=False)
    assert abs(world.look(**UNKNOWN) - world.place) < 0.3e-6
    assert (world.compensator.answer, world.compensator.drift) == before
    world.watch(3, **UNKNOWN)
    assert abs(world.compensator.answer - before[0]) < 0.3e-6


def test_a_clock_that_is_set_back_moves_nothing():
    world = World()
    world.watch(12, **UNKNOWN)
    world.t, world.record = world.t - 3600, FieldRecord()
    world.go(DT)
    assert abs(world.look(**UNKNOWN) - world.place) < 0.3e-6
    world.watch(3, **UNKNOWN)
    assert abs(world.look(**UNKNOWN) - world.place) < 0.3e-6
    assert abs(world.compensator.drift - DRIFT) < 0.4e-6


def test_another_particle_is_another_start():
    world = World()
    world.watch(12, **UNKNOWN)
    world.look(ids=np.array([9]), **UNKNOWN)
    assert not world.compensator.ready


def test_crabs_so_that_the_ground_is_covered_along_the_course():
    world = World()
    world.watch(12, **UNKNOWN)
    for course in (0.3, -2.0):
        field = world.compensator.steer(controller_input(1), course, 2e-3)
        assert np.hypot(*field) == pytest.approx(2e-3)
        made_good = ANSWER * complex(*field) / 2e-3 + DRIFT
        assert cmath.phase(made_good * cmath.exp(-1j * course)) == pytest.approx(0, abs=0.12)
