"""Tests that every effect must pass; call them in a test of your own package.

    from microbot_ros.conformance import exercise, exercise_discovery

    def test_my_effect_keeps_the_contract():
        exercise(MyEffect)

    def test_my_effect_is_found():
        exercise_discovery(MyEffect(0.5))

The package must be installed, since files, searches and simulations know effects by name.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from functools import cache
from pathlib import Path

import numpy as np

from microbot_ros.common.records import Commands, Conditions
from microbot_ros.discovery.check.input_checks import check_sessions
from microbot_ros.discovery.hypotheses import Hypotheses, consider, log_bayes_factor
from microbot_ros.discovery.search import CandidateFit
from microbot_ros.discovery.verdict import enough, judge, scrutinised
from microbot_ros.model.effect import STAGES, Effect
from microbot_ros.model.effect_context import EffectContext, Places
from microbot_ros.model.effects import EFFECTS
from microbot_ros.model.increments import respond
from microbot_ros.model.io.model_file import read_model, write_model
from microbot_ros.model.model import Model, ParticleParameters
from microbot_ros.model.physics.particle import Fluid
from microbot_ros.model.timeline import Timeline
from microbot_ros.virtual_rig.commands import steps
from microbot_ros.virtual_rig.foreign_effects import make_world
from microbot_ros.virtual_rig.injected_effects import INJECTABLE, inject_effect
from microbot_ros.virtual_rig.record_session import Camera, draw_swarm, record_session

FIELD = 5e-3  # choice: reference field [T], the default of the rig
PRIOR_OFF = 3.0
"""Choice: factor by which the declared typical sizes may be wrong."""
_COUNT = 3  # choice: particles, of which two remain if one is missing
_HOOKS = ('heading_offset', 'alignment_rate', 'speed_factor', 'drift')


def exercise(kind: type[Effect]) -> None:
    """Raise AssertionError, naming the defect, unless effects of a `kind` keep the contract.

    An effect must describe itself, with parameters in range; do nothing at strength zero, whatever
    its shape; stay finite at its bounds; have a smooth derivative along each parameter; keep
    particles and times apart as its hooks promise; declare correctly whether it needs positions,
    depends on absolute time or is linear; and survive a `model.yaml` to the last bit.

    Parameters
    ----------
    kind : type[Effect]
        Class of the effects.
    """
    assert EFFECTS.get(kind.id) is kind, (
        f"{kind.id} is not installed: name it in the entry points 'microbot_ros.effects'")
    _says_what_it_is(kind)
    _tells_whether_it_reads_positions(plain(kind))
    _does_nothing_at_zero(kind)
    _stays_finite(kind)
    _is_smooth(plain(kind))
    _broadcasts(plain(kind))
    _bears_gaps(plain(kind))
    _tells_whether_it_counts_time(plain(kind))
    _tells_whether_it_is_linear(plain(kind))
    _comes_back_from_a_file(kind)


def exercise_discovery(hidden: Effect) -> None:
    """Raise AssertionError unless discovery establishes `hidden` where it acts, and only there.

    Two sessions are simulated, half a minute of three particles under steps of the field at two
    strengths: with the effect, which must be strong enough, and without. Both verdicts must hold
    under priors narrower and wider by PRIOR_OFF than the effect declares.

    Parameters
    ----------
    hidden : Effect
        The effect.
    """
    known = _search(hidden.is_drive_curve, {hidden.id: {
        p.name: p.display_units(value) for p, value in hidden.values().items()}})
    established = _established(known)
    assert hidden.id in established, (
        f'{hidden.id} is hidden; established are: {", ".join(established) or "none"}')
    found = next(slot.own.found for slot in known.slots if slot.own.id == hidden.id)
    least = _log_evidence_under_other_priors(found).min()
    assert least >= enough(), (
        f"'prior' decides whether {hidden.id} is named: with one off by {PRIOR_OFF:g} its "
        f'log evidence is {least:.1f}, less than {enough():.1f}')
    nothing, established = _where_nothing_is_hidden(hidden.is_drive_curve)
    assert not established, f'nothing is hidden in the data; established: {", ".join(established)}'
    for one in nothing.more:
        if one.id == hidden.id:
            most = _log_evidence_under_other_priors(one.found).max()
            assert most < enough(), (
                f"'prior' decides whether {hidden.id} is named where nothing is hidden: its log "
                f'evidence is {most:.1f}, more than {enough():.1f}')


@cache
def _where_nothing_is_hidden(rolls: bool) -> tuple[Hypotheses, list[str]]:
    """Return the result and the established effects without an effect, cached for all effects."""
    known = _search(rolls, {})
    return known, _established(known)


def _established(known: Hypotheses) -> list[str]:
    judgement = scrutinised(known, judge(known))
    return [name for name in known.names if judgement.status(name) == 'established']


def _log_evidence_under_other_priors(found: CandidateFit) -> np.ndarray:
    """Return the log evidence (2,) of an effect under a narrower and a wider prior."""
    return np.array([log_bayes_factor(found, wider) for wider in (1 / PRIOR_OFF, PRIOR_OFF)])


def plain(kind: type[Effect]) -> Effect:
    """Return an effect of a `kind` at typical strength, with its shape away from the default.

    Parameters
    ----------
    kind : type[Effect]
        Class of the effect.

    Returns
    -------
    Effect
        The effect.
    """
    return kind(**{
        p.field: p.from_fit(1.3) if p.shape or p.inverse else p.null_value + 0.7 * p.scale
        for p in kind.parameters()})


def _says_what_it_is(kind: type[Effect]) -> None:
    assert kind.stage in STAGES, f"'stage' must be one of {STAGES}; received {kind.stage}"
    assert kind.__doc__, 'has no docstring: its equation, for the report'
    assert kind.summary.endswith('.'), "'summary' must be a sentence"
    assert 0 < kind.prior[0] < kind.prior[1] < math.inf, (
        f"'prior' must be two ascending positive numbers; received {kind.prior}")
    assert kind.lookalike_time >= 0, (
        f"'lookalike_time' must not be negative; received {kind.lookalike_time}")
    assert kind.required_excitation.strip(), "has no 'required_excitation'"
    assert kind.id not in kind.confounded_with, 'is confounded with itself'
    assert any(not p.shape for p in kind.parameters()), 'has no strength'
    for p in kind.parameters():
        assert p.meaning.strip(), f'{p.name} has no meaning'
        assert p.scale > 0, f'{p.name}: scale must be positive; received {p.scale}'
        assert p.floor >= 0, f'{p.name}: floor must not be negative; received {p.floor}'
        assert p.low < p.high, f'{p.name}: low must be below high'
        assert p.low <= p.null_value <= p.high, f'{p.name}: null_value lies beyond the bounds'
        assert p.to_fit(p.null_value) == 0, f'{p.name}: inverse needs the null_value infinity'
        assert math.isfinite(p.low) or p.inverse, f'{p.name}: low must be finite'
        assert math.isfinite(p.high) or p.inverse, f'{p.name}: high must be finite'


def _does_nothing_at_zero(kind: type[Effect]) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        shape = {p.field: float(rng.uniform(p.low, p.high)) for p in kind.parameters() if p.shape}
        off = dataclasses.replace(kind.null(), **shape)
        assert np.allclose(_moved(off), _moved(), rtol=1e-12, atol=1e-21), (
            f'moves particles at zero strength, with {shape}')


def _stays_finite(kind: type[Effect]) -> None:
    for p in kind.parameters():
        for end in (p.low, p.high):
            there = dataclasses.replace(plain(kind), **{p.field: end})
            assert np.isfinite(_moved(there)).all(), f'is not finite at {p.field} = {end}'


def _is_smooth(effect: Effect) -> None:
    model = _model(effect)
    at = model.vector()
    for k, p in enumerate(effect.parameters()):
        coarse, fine = (_slope(model, at, k, step) for step in (1e-3, 1e-4))
        size = np.abs(fine).max()
        assert np.isfinite(fine).all(), f'{p.name}: its derivative is not finite'
        assert size > 1e-12, f'{p.name} changes nothing at {effect}'
        assert np.allclose(coarse, fine, rtol=0, atol=1e-4 * size), (
            f'{p.name}: its derivative depends on the step, so fits cannot follow it')


def _slope(model: Model, at: np.ndarray, k: int, step: float) -> np.ndarray:
    shift = step * np.eye(len(at))[k]
    ends = [_moved(model.with_vector(at + s).effects[0]) for s in (shift, -shift)]
    return np.asarray(ends[0] - ends[1]) / (2 * step)


def _broadcasts(effect: Effect) -> None:
    """Check that hooks give the same for many times at once as for each, and for each particle."""
    rng = np.random.default_rng(2)
    context = EffectContext(
        rng.uniform(0, 9, (4, 1)), rng.uniform(0, 0.1, (4, 1)), rng.normal(0, 1e-3, (4, 1, 2)),
        rng.uniform(1, 9, (4, 1)), FIELD, Places(rng.normal(0, 3e-5, (4, _COUNT, 2))))
    for hook in _HOOKS:
        together = getattr(effect, hook)(context)
        for k in range(4):
            one = getattr(effect, hook)(context.at(k, Places(context.position[k])))
            assert (together is None) == (one is None), f'{hook} returns values only sometimes'
            if together is not None:
                axes = (_COUNT, 2) if hook == 'drift' else (_COUNT,)
                whole = np.broadcast_to(together, (4, *axes))[k]
                assert np.allclose(whole, np.broadcast_to(one, axes), rtol=1e-12, atol=1e-22), (
                    f'{hook} mixes times')
    field, place = context.field, context.position
    for of, values in ((effect.field, field), (effect.observe, place)):
        alone = np.stack([of(row) for row in values])
        assert np.allclose(of(values), alone, rtol=1e-12, atol=1e-22), f'{of.__name__} mixes times'
    back = effect.true_position(effect.observe(place))
    assert np.allclose(back, place, rtol=1e-12, atol=0), 'true_position does not undo observe'
    assert effect.latency() >= 0, 'latency must not be negative'


def _bears_gaps(effect: Effect) -> None:
    """Check that a missing particle acts like one that is not there."""
    whole = _timeline()
    assert whole.positions is not None
    gap = whole.positions.copy()
    gap[10:20, -1] = np.nan
    seen = _moved(effect, Timeline(whole.commands, whole.times, gap))
    two = Timeline(whole.commands, whole.times, whole.positions[:, :-1])
    assert np.allclose(seen[10:20, :-1], _moved(effect, two)[10:20], rtol=1e-12, atol=1e-21), (
        'a particle that is missing moves the others')
    assert np.isfinite(seen[:10]).all(), 'a gap acts before it begins'


def _tells_whether_it_reads_positions(effect: Effect) -> None:
    line = _timeline()
    blind = Timeline(line.commands, line.times)
    if effect.needs_position:
        assert _refuses(effect, blind), "'needs_position' is True, but no hook reads positions"
    else:
        assert not _refuses(effect, blind), "a hook reads positions: 'needs_position' must be True"


def _tells_whether_it_counts_time(effect: Effect) -> None:
    line = _timeline()
    commands = Commands(line.commands.t + 50, line.commands.field, line.commands.frequency)
    later = Timeline(commands, line.times + 50, line.positions)
    same = np.allclose(_moved(effect, later), _moved(effect, line), rtol=1e-6, atol=1e-15)
    assert same == effect.time_invariant, (
        f"'time_invariant' is {effect.time_invariant}; 50 s later it does "
        f'{"the same" if same else "something else"}')


def _tells_whether_it_is_linear(effect: Effect) -> None:
    if not effect.proportional:
        return
    twice = dataclasses.replace(effect, **{
        p.field: 2 * getattr(effect, p.field) for p in effect.parameters() if not p.shape})
    assert np.allclose(_moved(twice) - _moved(), 2 * (_moved(effect) - _moved()),
                       rtol=1e-6, atol=1e-15), "is not linear: 'proportional' must be False"
    assert not any(map(effect.overrides, (
        'latency', 'field', 'heading_offset', 'alignment_rate', 'speed_factor', 'observe'))), (
        "'proportional' is True, but it has hooks beside 'drift'")


def _refuses(effect: Effect, line: Timeline) -> bool:
    try:
        respond(_model(effect), line)
    except ValueError:
        return True
    return False


def _comes_back_from_a_file(kind: type[Effect]) -> None:
    ends = [kind(**{p.field: getattr(p, end) for p in kind.parameters()})
            for end in ('low', 'high')]
    thirds = dataclasses.replace(plain(kind), **{
        p.field: p.from_fit(p.to_fit(getattr(plain(kind), p.field)) / 3)
        for p in kind.parameters()})
    with tempfile.TemporaryDirectory() as folder:
        for effect in (kind.null(), plain(kind), thirds, *ends):
            path = Path(folder) / 'model.yaml'
            write_model(path, _model(effect), _particles(_COUNT))
            back = read_model(path)[0]
            assert back == _model(effect), f'{effect} comes back from model.yaml as {back.effects}'


def _model(*effects: Effect) -> Model:
    return Model(FIELD, effects=effects)


def _particles(count: int) -> ParticleParameters:
    """Return the first `count` of three particles."""
    return ParticleParameters(
        np.arange(count), np.array([3e-6, 4e-6, 5e-6])[:count], np.array([-2.0, 0.5, 3.0])[:count])


def _timeline() -> Timeline:
    """Return 5 s of steps in direction, strength and frequency, with a pause, some mid-frame."""
    rng = np.random.default_rng(5)
    t = np.array([-1.0, 0.0, 0.91, 2.017, 2.8, 3.55, 4.49])
    angle = rng.uniform(-np.pi, np.pi, len(t))
    field = rng.uniform(1e-3, 4e-3, len(t))[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
    field[4] = 0.0
    start = rng.uniform(-30e-6, 30e-6, (1, _COUNT, 2))
    walk = np.cumsum(rng.normal(0, 1e-7, (151, _COUNT, 2)), axis=0)
    commands = Commands(t, field, rng.uniform(0.5, 20.0, len(t)))
    return Timeline(commands, np.arange(151) / 30, start + walk)


def _moved(effect: Effect | None = None, line: Timeline | None = None) -> np.ndarray:
    """Return displacements (T−1, N, 2) [m] along a timeline."""
    line = line or _timeline()
    count = _COUNT if line.positions is None else line.positions.shape[1]
    model = _model() if effect is None else _model(effect)
    return respond(model, line).increments(_particles(count))


def _search(rolls: bool, effects: dict[str, dict[str, float]]) -> Hypotheses:
    """Return what discovery finds in a session with these `effects`, of rollers or swimmers."""
    rng = np.random.default_rng(7)
    swarm = draw_swarm(rng, _COUNT, Fluid(1.245e-3), FIELD, radius=2.3e-6, half_extent=40e-6)
    if rolls:
        swarm['gain'], swarm['speed'] = swarm['speed'] / 8, 0.0
    for name, values in effects.items():
        if name in INJECTABLE:
            inject_effect(swarm, name, values, FIELD)
    commands = steps(rng, 30.0, (0.4 * FIELD, FIELD), (0.5, 3.0),
                     frequency=(1.0, 2.0, 5.0, 10.0, 20.0) if rolls else None)
    known = Conditions(
        'rolling' if rolls else 'catalytic', 2.3e-6, 1.245e-3, reference_field=FIELD)
    session, _ = record_session(make_world(swarm, rng, effects, FIELD), commands,
                                Camera(20.0, 0.5, 0.1e-6), 30.0, rng, known)
    return consider(check_sessions([session])[0])
