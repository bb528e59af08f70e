"""Names of place that together are but a series for something that has no name."""

from __future__ import annotations

import numpy as np
import pytest

from bench._unlisted_worlds import KINDS, HiddenWorld, _experiment
from microbot_ros.discovery.input_checks import check_sessions
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.discovery.stand_ins import fields_of_place, series_for_a_field
from microbot_ros.estimation.model_fit import fit_sessions
from microbot_ros.model.model import Model
from microbot_ros.virtual_rig.record_session import record_session


def _fitted(session, names):
    prepared, _ = check_sessions([session])
    fit = fit_sessions(Model.baseline(session.conditions, session.commands), prepared)
    for name in names:
        fit = fit_candidate(fit, name).fit
    return fit


@pytest.mark.parametrize(('names', 'fields'), [
    (('uniform_drift', 'linear_flow'), ('uniform_drift', 'linear_flow')),
    (('uniform_drift', 'coil_gain_mismatch'), ()),
    (('linear_flow', 'speed_decay'), ()),
    ((), ())])
def test_only_drifts_of_place_are_a_series(film, names, fields):
    session, _ = film(2, {'uniform_drift': {'wx_um_s': 0.5, 'wy_um_s': -0.4}})
    assert fields_of_place(_fitted(session, names).model) == fields


def test_two_fields_that_are_there_are_no_series(film):
    session, _ = film(6, {
        'uniform_drift': {'wx_um_s': 0.5, 'wy_um_s': -0.4},
        'linear_flow': {'gxx_per_s': 0.01, 'gxy_per_s': -0.02, 'gyx_per_s': 0.02,
                        'gyy_per_s': 0.01}}, count=4)
    assert series_for_a_field(_fitted(session, ('uniform_drift', 'linear_flow'))) is None


def test_a_vortex_is_no_flow_and_spot_and_drift():
    rng = np.random.default_rng(5)
    experiment, extent = _experiment(rng, 60.0, False)
    world = HiddenWorld(experiment.swarm, rng, KINDS['vortex'].make(rng, extent, 60.0), 2.0)
    session, _ = record_session(world, experiment.control(), experiment.camera, 60.0, rng,
                                experiment.conditions)
    names = ('linear_flow', 'hot_spot', 'uniform_drift')
    series = series_for_a_field(_fitted(session, names))
    assert set(series.names) == set(names)
    assert not series.rest.model.effects
