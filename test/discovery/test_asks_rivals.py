"""The rules of the literature that asking is measured against, and the order of the runs."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench._asks_rivals import (
    CERTAIN,
    RULES,
    _square,
    adequate,
    akaike_weights,
    by_rule,
    divergence,
    expected_weight,
    furthest,
)
from bench._asks_worlds import hidden_world
from bench.asks import (
    MINUTES,
    SETTLED,
    Run,
    as_often_wrong,
    every_case,
    median_minutes,
    wrongs,
)

SHARES = arrays(float, 4, elements=st.floats(0.01, 1.0)).map(lambda w: w / w.sum())
APART = arrays(float, 6, elements=st.floats(0.0, 50.0)).map(_square)


def found(*pairs):
    return [SimpleNamespace(likelihood_ratio=ratio, dof=dof) for ratio, dof in pairs]


@given(SHARES, APART)
def test_box_and_hill_count_every_pair_once(weights, gains):
    pairs = [(i, j) for i in range(4) for j in range(i)]
    expected = sum(weights[i] * weights[j] * gains[i, j] for i, j in pairs)
    assert divergence(weights, gains) == pytest.approx(expected)


def test_the_furthest_pair_is_one_of_those_that_are_left():
    gains = _square(np.array([9.0, 1.0, 2.0]))
    assert furthest(np.array([0.5, 0.0, 0.5]), gains) == 1.0
    assert furthest(np.full(3, 1 / 3), gains) == 9.0


def test_chi_square_refuses_what_lies_far_behind_the_best():
    # 6.63 is the 99th percentile of χ² of one degree of freedom.
    np.testing.assert_allclose(adequate(found((20.0, 1), (13.5, 1), (13.0, 1))), [0, .5, .5, 0])
    np.testing.assert_allclose(adequate(found((6.0, 1), (1.0, 2))), 1 / 3)


def test_akaike_weights_are_those_of_the_definition():
    weights = akaike_weights(found((10.0, 1), (12.0, 3)))
    np.testing.assert_allclose(np.log(weights / weights[0]), [0.0, 4.0, 3.0])


@given(SHARES, APART)
def test_more_divergence_leaves_more_weight_to_who_is_right(weights, gains):
    now = expected_weight(weights, np.zeros((4, 4)))
    assert now == pytest.approx((weights**2).sum())
    assert now - 1e-12 <= expected_weight(weights, gains) <= expected_weight(
        weights, 2 * gains) + 1e-12 <= 1 + 1e-9


@pytest.mark.soak
@pytest.mark.parametrize('name', RULES)
def test_a_rule_names_what_shows_plainly_and_soon(name):
    rig, _ = hidden_world(1, ('coil_gain_mismatch',), 60.0)
    said = by_rule(RULES[name], rig, 3.0, 0)
    taken = next(one for one in said if one.sure > RULES[name].decided)
    assert taken.name == 'coil_gain_mismatch'
    assert taken.seconds <= 120
    # It goes on, and ever surer, so that it can be asked for more.
    assert said[-1].seconds > 175 or said[-1].sure > CERTAIN
    assert said[-1].sure > taken.sure


def test_how_sure_a_rule_is_passes_what_it_asks_for_where_a_model_is_left_alone():
    few, many = found((20.0, 1), (13.5, 1)), found((40.0, 1), (13.5, 1))
    chi2 = RULES['buzzi_ferraris']
    # 6.63 is the 99th percentile of χ² of one degree of freedom.
    assert chi2.sure(few) < chi2.decided < chi2.sure(many)
    assert (adequate(few) > 0).sum() > 1 == (adequate(many) > 0).sum()
    assert chi2.sure(found((20.0, 1), (20.0 - 6.6349, 1))) == pytest.approx(chi2.decided, abs=1e-4)
    akaike = RULES['akaike_weights']
    assert akaike.sure(many) == pytest.approx(19.0 - np.logaddexp(5.75, 0.0))
    assert akaike.decided == pytest.approx(np.log(999))


# Minutes to the same share of wrong names -------------------------------------------------------

def ran(hidden, seed, *course):
    return Run('one', hidden, seed, 'settled', 1.0, (), (), (), (), course)


def test_a_rule_that_is_wrong_more_often_is_asked_to_be_surer():
    worlds = [(('uniform_drift',), 0), ((), 1000), (('trap',), 4000)]
    ours = [ran(*worlds[0], (1.0, 'uniform_drift', SETTLED)), ran(*worlds[1]), ran(*worlds[2])]
    theirs = [ran(*worlds[0], (0.5, 'coil_pull', 2.0), (0.8, 'uniform_drift', 6.0),
                  (2.0, 'uniform_drift', 9.0)),
              ran(*worlds[1], (3.0, 'coil_pull', 1.0), (5.0, '', 9.0)),
              ran(*worlds[2], (4.0, 'linear_flow', 7.0))]
    assert [wrongs(theirs, sure) for sure in (0.0, 1.5, 6.5, 7.5)] == [3, 2, 1, 0]
    sure = as_often_wrong(theirs, ours)
    assert sure == 9.0
    assert median_minutes(theirs, sure) == 2.0
    # Where ours is wrong as well, less is asked for, and no wrong name comes too late to count.
    ours[2] = ran(*worlds[2], (5.0, 'linear_flow', SETTLED))
    assert as_often_wrong(theirs, ours) == 6.0
    assert median_minutes(theirs, 6.0) == 0.8


def test_what_is_never_right_takes_all_the_time_there_is():
    world = ('uniform_drift',), 0
    assert median_minutes([ran(*world)], 0.0) == MINUTES
    assert median_minutes([ran(*world, (1.0, 'coil_pull', 9.0))], 0.0) == MINUTES
    late = ran(*world, (1.0, '', 9.0), (2.0, 'uniform_drift', 9.0))
    assert median_minutes([late], 0.0) == MINUTES


def test_every_kind_has_had_its_turn_whenever_it_is_stopped():
    cases = every_case()
    assert len(set(cases)) == len(cases)
    kinds = Counter(asked for asked, *_ in cases)
    fewest = min(kinds.values())
    assert fewest >= 3
    for turns in (1, 3, fewest):
        begun = Counter(asked for asked, *_ in cases[:turns * len(kinds)])
        assert begun == dict.fromkeys(kinds, turns)
