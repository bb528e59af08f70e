"""The gate: every limit swept densely across its boundary, armed and disarmed alike."""

import dataclasses
import math

import numpy as np
import pytest

from microbot_ros.drive.gate import Gate, Limits, Reason

ZERO = (0.0,) * 4

LIMITS = Limits(
    current_A=2.0, step_A=3.0, slew_A_per_s=10.0, command_timeout_s=0.125, deviation_A=0.25,
    settling_s=0.0625, feedback_timeout_s=0.25, rated_current_A=1.0, thermal_s=8.0, idle_s=64.0)
NOT_FINITE = [math.nan, math.inf, -math.inf]
COILS = range(4)


def only(coil: int, value: float) -> tuple[float, ...]:
    return tuple(value if index == coil else 0.0 for index in COILS)


def around(boundary: float) -> list[tuple[float, bool]]:
    """Values across a boundary, and whether each is within ±boundary."""
    steps = [math.nextafter(boundary, 0), boundary, math.nextafter(boundary, math.inf)]
    near = [boundary * (1 + k * 1e-3) for k in range(-5, 6)]
    far = [0.5 * boundary, 2 * boundary, 1e6 * boundary]
    values = [sign * value for value in steps + near + far for sign in (1, -1)]
    return [(value, abs(value) <= boundary) for value in values] + [
        (value, False) for value in NOT_FINITE]


def armed(limits: Limits = LIMITS) -> Gate:
    gate = Gate(limits)
    gate.measured(ZERO, 0.0)
    assert gate.arm(0.0) is None
    return gate


def driving(currents: tuple[float, ...], limits: Limits = LIMITS) -> Gate:
    gate = armed(limits)
    assert gate.command(currents, 0.0) == currents
    return gate


def tripped(gate: Gate, reason: Reason) -> bool:
    assert gate.output == ZERO
    assert not gate.armed
    assert gate.fault is not None
    assert gate.fault.detail
    return gate.fault.reason is reason


def test_it_is_silent_until_armed():
    gate = Gate(LIMITS)
    assert (gate.armed, gate.fault, gate.output) == (False, None, ZERO)
    for value, _ in around(2.0):
        assert gate.command((value,) * 4, 0.0) == ZERO
    assert gate.fault is None


@pytest.mark.parametrize('coil', COILS)
@pytest.mark.parametrize(('value', 'within'), around(2.0))
def test_current_limit(coil, value, within):
    gate = armed()
    wanted = only(coil, value)
    if within:
        assert gate.command(wanted, 0.0) == wanted == gate.output
        assert gate.fault is None
    else:
        assert gate.command(wanted, 0.0) == ZERO
        assert tripped(gate, Reason.LIMIT if math.isfinite(value) else Reason.MALFORMED)
        assert gate.command(ZERO, 0.0) == ZERO
        assert tripped(gate, Reason.LIMIT if math.isfinite(value) else Reason.MALFORMED)


@pytest.mark.parametrize('malformed', [
    (), (0.0,) * 3, (0.0,) * 5, (None,) * 4, '0000', 'oops', ('1', '1', '1', '1'), 7, None,
    (10**400, 0, 0, 0), [[0.0] * 4] * 4, (1j, 0, 0, 0),
])
def test_what_is_not_four_numbers_trips(malformed):
    gate = driving((1.0,) * 4)
    assert gate.command(malformed, 0.0) == ZERO
    assert tripped(gate, Reason.MALFORMED)
    gate = Gate(LIMITS)
    assert gate.measured(malformed, 0.0) == ZERO
    assert tripped(gate, Reason.MALFORMED)


def test_numpy_values_come_out_as_floats():
    out = armed().command(np.array([0.5, -0.5, 1, 0], np.float32), 0.0)
    assert out == (0.5, -0.5, 1.0, 0.0)
    assert all(type(value) is float for value in out)


@pytest.mark.parametrize('coil', COILS)
@pytest.mark.parametrize(('change', 'within'), around(3.0)[:22])
def test_step_limit(coil, change, within):
    start = -math.copysign(1.5, change)
    gate = driving(only(coil, start), Limits(**{**vars(LIMITS), 'current_A': 100.0}))
    gate.command(only(coil, start), 0.0)
    for now in (0.1, 0.2):  # time restores the allowance that the start used up, and no more
        gate.measured(only(coil, start), now)
        gate.command(only(coil, start), now)
    wanted = only(coil, start + change)
    exact = abs(wanted[coil] - start) <= 3.0
    assert gate.command(wanted, 0.2) == (wanted if exact else ZERO)
    assert exact or tripped(gate, Reason.SLEW)
    assert exact == within or abs(abs(change) - 3.0) < 1e-12


def test_changes_share_one_allowance_that_time_restores():
    gate = driving(only(0, 1.5))
    assert gate.command(only(0, 0.25), 0.0) == only(0, 0.25)
    gate.measured(only(0, 0.25), 0.0625)
    assert gate.command(only(0, 1.125), 0.0625) == only(0, 1.125)  # left: 0.25 + 0.625 − 0.875
    assert gate.command(only(1, 1.0), 0.0625) == ZERO  # coil 2 may, coil 1 may not
    assert tripped(gate, Reason.SLEW)


def test_a_fault_leaves_no_fresh_allowance():
    gate = driving(only(2, 2.0))
    gate.trip(Reason.LINE, 'test')
    gate.measured(ZERO, 0.0)
    assert gate.arm(0.0) is None
    assert gate.command(only(2, 0.001), 0.0) == ZERO
    assert tripped(gate, Reason.SLEW)


def test_zero_is_affirmed_whatever_the_slew():
    gate = driving((2.0, -2.0, 2.0, -2.0))
    assert gate.command(ZERO, 0.0) == ZERO
    assert gate.armed
    assert gate.fault is None


@pytest.mark.parametrize(('age', 'holds'), [
    (0.0, True), (math.nextafter(0.125, 0), True), (0.125, True),
    (math.nextafter(0.125, 1), False), (0.2, False),
])
def test_a_command_goes_stale(age, holds):
    gate = driving(only(1, 0.5))
    gate.measured(only(1, 0.5), 0.0)
    assert gate.tick(age) == (only(1, 0.5) if holds else ZERO)
    assert holds or tripped(gate, Reason.STALE)


def test_a_late_command_finds_the_gate_tripped():
    gate = driving(only(1, 0.5))
    assert gate.command(only(1, 0.5), 0.2) == ZERO
    assert tripped(gate, Reason.STALE)


def test_each_command_starts_the_time_anew():
    gate = armed()
    for step in range(50):
        now = step * 0.125
        gate.measured(gate.output, now)
        assert gate.command((0.5,) * 4, now) == (0.5,) * 4


def test_a_zero_never_goes_stale():
    gate = armed()
    for now in np.arange(0.0, 10.0, 0.25):
        gate.measured(ZERO, now)
        assert gate.tick(now) == ZERO
    assert gate.armed


@pytest.mark.parametrize('output', [ZERO, (0.5,) * 4])
@pytest.mark.parametrize(('age', 'holds'), [
    (math.nextafter(0.25, 0), True), (0.25, True), (math.nextafter(0.25, 1), False),
])
def test_no_current_without_measurements(output, age, holds):
    gate = driving(output, Limits(**{**vars(LIMITS), 'command_timeout_s': 10.0}))
    assert gate.tick(age) == (output if holds else ZERO)
    assert gate.armed == holds
    assert holds or tripped(gate, Reason.SILENCE)


@pytest.mark.parametrize('coil', COILS)
@pytest.mark.parametrize(('error', 'within'), around(0.25))
def test_a_measurement_away_from_the_command_trips(coil, error, within):
    gate = driving((1.0,) * 4)
    gate.measured((1.0,) * 4, 0.07)
    measured = [1.0] * 4
    measured[coil] += error
    within = 0.75 <= measured[coil] <= 1.25  # as rounded
    assert gate.measured(measured, 0.07) == ((1.0,) * 4 if within else ZERO)
    reason = Reason.DEVIATION if math.isfinite(error) else Reason.MALFORMED
    assert within or tripped(gate, reason)


@pytest.mark.parametrize('coil', COILS)
@pytest.mark.parametrize(('value', 'within'), around(0.25))
def test_current_without_a_command_trips_a_disarmed_gate_too(coil, value, within):
    gate = Gate(LIMITS)
    assert gate.measured(only(coil, value), 0.0) == ZERO
    assert (gate.fault is None) == within
    assert within or tripped(
        gate, Reason.UNCOMMANDED if math.isfinite(value) else Reason.MALFORMED)


@pytest.mark.parametrize(('age', 'settled'), [
    (0.0, False), (0.03, False), (math.nextafter(0.0625, 0), False), (0.0625, True), (0.1, True),
])
def test_a_current_has_the_settling_time_to_follow(age, settled):
    for reading in (0.26, 0.5, 0.6, 1.25):  # what no output was is no late reading either
        gate = driving(only(3, 1.0))
        still_settling = gate.measured(only(3, reading), age) != ZERO
        assert still_settling == (not settled or reading == 1.25)


def test_it_settles_from_every_command_of_the_settling_time():
    gate = driving(only(0, 1.0))
    gate.command(only(0, -0.5), 0.03)
    gate.command(only(0, 0.25), 0.06)
    for reading, passes in ((1.25, True), (-0.75, True), (1.26, False)):
        assert (gate.measured(only(0, reading), 0.06) != ZERO) == passes
    gate = driving(only(0, 1.0))
    gate.command(only(0, -0.5), 0.03)
    gate.command(only(0, 0.25), 0.06)
    assert gate.measured(only(0, -0.75), 0.1) != ZERO  # 1.0 was gone at 0.03, −0.5 at 0.06
    assert gate.measured(only(0, 1.3), 0.1) == ZERO


def test_heat_follows_the_exponential_and_trips_above_what_a_coil_bears():
    limits = Limits(**{**vars(LIMITS), 'command_timeout_s': 100.0, 'feedback_timeout_s': 100.0})
    gate = driving((0.0, 2.0, -1.0, 0.5), limits)
    until_hot = -8.0 * math.log(1 - 1 / 4)  # 4 (1 − exp(−t/8)) = 1
    for now in np.linspace(0.01, until_hot - 1e-6, 37):
        assert gate.measured(gate.output, now) != ZERO
        assert gate.tick(now) != ZERO
    rise = 1 - math.exp(-(until_hot - 1e-6) / 8)
    assert gate.heat == pytest.approx((0.0, 4 * rise, rise, 0.25 * rise), rel=1e-9)
    assert gate.tick(until_hot + 1e-6) == ZERO
    assert tripped(gate, Reason.HEAT)
    gate.measured(ZERO, until_hot + 1e-6)
    assert 'thermal limit' in gate.arm(until_hot + 1e-6)
    gate.tick(until_hot + 1.0)
    assert gate.heat[1] == pytest.approx(math.exp(-1 / 8), rel=1e-4)
    assert gate.arm(until_hot + 1.0) is None


def test_a_coil_bears_its_continuous_current_for_ever():
    gate = driving((1.0,) * 4)
    for now in np.arange(0.0, 200.0, 0.125):
        gate.measured((1.0,) * 4, now)
        assert gate.command((1.0,) * 4, now) == (1.0,) * 4
    assert gate.heat == pytest.approx((1.0,) * 4)


@pytest.mark.parametrize(('output', 'measured'), [
    (0.75, 0.5), (-0.75, -0.5), (0.5, 0.75), (-0.5, -0.75),
])
def test_the_larger_of_commanded_and_measured_heats(output, measured):
    gate = driving(only(0, output), Limits(**{**vars(LIMITS), 'rated_current_A': 0.5}))
    gate.measured(only(0, measured), 0.0)
    before = gate.heat[0]
    assert before == 0.0
    gate.tick(0.1)
    assert gate.heat[0] == pytest.approx(1.5**2 * -math.expm1(-0.1 / 8), rel=1e-12)


def test_a_coil_may_be_exactly_as_hot_as_it_bears():
    gate = driving((0.5,) * 4, Limits(**{
        **vars(LIMITS), 'rated_current_A': 0.5, 'thermal_s': 1e-4, 'settling_s': 1.0}))
    gate.measured((0.5,) * 4, 0.0)
    assert gate.tick(0.125) == (0.5,) * 4
    assert gate.heat == (1.0,) * 4
    gate.revoke()
    gate.measured(ZERO, 0.125)
    assert gate.arm(0.125) is None


def test_a_fault_says_what_a_person_needs():
    limits = Limits(**{**vars(LIMITS), 'command_timeout_s': 1.0, 'feedback_timeout_s': 2.0,
                       'rated_current_A': 0.5, 'thermal_s': 1e-4})
    gate = armed(limits)
    gate.measured(ZERO, 1.0)
    gate.command(only(2, 0.6), 1.0)
    gate.tick(1.5)
    assert gate.fault.detail == 'a coil is at 144% of its thermal limit'
    gate.measured(ZERO, 1.5)
    assert gate.arm(1.5) == 'a coil is at 144% of its thermal limit'
    gate = armed(limits)
    gate.measured(ZERO, 1.0)
    gate.command(only(2, 0.1), 1.0)
    gate.tick(2.5)
    assert gate.fault.detail == 'none for 1.500 s'
    gate = armed(limits)
    gate.measured(ZERO, 1.0)
    gate.tick(3.25)
    assert gate.fault.detail == 'none for 2.250 s'
    gate = armed(limits)
    gate.command(only(2, 0.1), 2.0, 0.5)
    assert gate.fault.detail == 'given 1.500 s ago'
    gate = armed(limits)
    gate.command(only(2, 2.5), 0.0)
    assert gate.fault.detail == '(0, 0, 2.5, 0) A is not within ±2 A'


def test_a_nonsensical_measurement_does_not_heat_for_ever():
    gate = Gate(LIMITS)
    gate.measured((1e200,) * 4, 0.0)
    gate.measured(ZERO, 0.001)
    assert max(gate.heat) == pytest.approx(1e6 * -math.expm1(-0.001 / 8))
    gate.measured(ZERO, 200.0)
    assert gate.arm(200.0) is None


@pytest.mark.parametrize('call', ['command', 'measured', 'tick', 'arm'])
@pytest.mark.parametrize('now', [*NOT_FINITE, math.nextafter(1.0, 0), 0.5, -1.0])
def test_a_clock_that_goes_wrong_trips(call, now):
    gate = driving((0.5,) * 4, Limits(**{
        **vars(LIMITS), 'command_timeout_s': 5.0, 'feedback_timeout_s': 5.0}))
    assert gate.tick(1.0) != ZERO
    arguments = ((0.5,) * 4, now) if call in ('command', 'measured') else (now,)
    answer = getattr(gate, call)(*arguments)
    assert 'clock' in answer if call == 'arm' else answer == ZERO
    assert tripped(gate, Reason.CLOCK)
    assert gate.tick(1.0) == ZERO


@pytest.mark.parametrize(('measured', 'age', 'refusal'), [
    (None, 0.0, 'no measured currents'),
    (ZERO, 0.25, None),
    (ZERO, math.nextafter(0.25, 1), 'no measured currents'),
    ((0.25, -0.25, 0.25, -0.25), 0.0, None),
    (only(0, math.nextafter(0.25, 1)), 0.0, 'measured while zero is commanded'),
    (only(1, -0.3), 0.0, 'measured while zero is commanded'),
    (only(3, math.inf), 0.0, 'no measured currents'),
])
def test_arming_needs_a_fresh_measurement_of_no_current(measured, age, refusal):
    gate = Gate(LIMITS)
    if measured is not None:
        gate.measured(measured, 0.0)
    fault = gate.fault
    answer = gate.arm(age)
    assert gate.armed == (answer is None) == (refusal is None)
    assert refusal is None or refusal in answer
    assert gate.fault is (fault if refusal else None)


def test_arming_an_armed_gate_changes_nothing():
    gate = driving((0.5,) * 4)
    gate.measured((0.5,) * 4, 0.0)
    assert gate.arm(0.01) is None
    assert gate.output == (0.5,) * 4
    assert gate.arm(0.2) is not None  # stale by now
    assert tripped(gate, Reason.STALE)


def test_limits_and_faults_cannot_be_changed():
    gate = driving(ZERO)
    gate.trip(Reason.LINE, 'unplugged')
    for fixed, name in ((gate.limits, 'current_A'), (gate.fault, 'reason')):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(fixed, name, 1e9)


def test_revoking_zeroes_and_keeps_the_fault():
    gate = driving((0.5,) * 4)
    gate.revoke()
    assert (gate.output, gate.armed, gate.fault) == (ZERO, False, None)
    assert gate.command((0.5,) * 4, 0.0) == ZERO
    gate.trip(Reason.LINE, 'unplugged')
    gate.trip(Reason.HEAT, 'later')
    gate.revoke()
    assert gate.fault.reason is Reason.LINE
    assert gate.fault.detail == 'unplugged'


def test_after_disarming_the_current_may_still_fall():
    gate = driving((1.0,) * 4)
    gate.revoke()
    gate.measured((1.0,) * 4, 0.06)
    assert gate.fault is None
    gate.measured((1.0,) * 4, 0.2)
    gate.measured((1.0,) * 4, math.nextafter(0.3125, 0))  # late, as the line may be
    assert gate.fault is None
    assert 'no measured currents' in gate.arm(math.nextafter(0.3125, 0))
    gate.measured((1.0,) * 4, 0.3125)
    assert tripped(gate, Reason.UNCOMMANDED)


@pytest.mark.parametrize('first', [Reason.STALE, Reason.HEAT, Reason.LINE, Reason.SELF_CHECK])
def test_current_that_nobody_commands_outranks_the_fault_that_stands(first):
    gate = driving((1.0,) * 4)
    gate.trip(first, 'first')
    gate.measured((1.0, 1.0, 1.0, -1.0), 0.03)  # as of a coil that is reversed, while it settles
    assert tripped(gate, first)
    gate.measured(ZERO, 0.25)
    gate.measured(only(1, 0.7), 0.5)
    assert tripped(gate, Reason.UNCOMMANDED)
    assert gate.fault.detail == '(0, 0.7, 0, 0) A measured while zero is commanded'
    gate.measured(ZERO, 0.75)
    assert tripped(gate, Reason.UNCOMMANDED)  # latched, as every fault


def test_a_coil_that_settles_alone_is_not_at_rest():
    gate = driving(only(0, 1.0))
    gate.trip(Reason.SELF_CHECK, 'first')
    gate.measured(only(0, -1.0), 0.03)
    assert tripped(gate, Reason.SELF_CHECK)


def test_current_at_rest_ends_the_permission_of_an_armed_gate():
    gate = armed()
    assert gate.measured(only(1, 0.7), 0.1) == ZERO
    assert tripped(gate, Reason.DEVIATION)


def test_nothing_from_before_flows_until_a_zero_is_commanded():
    gate = armed()
    gate.hold()
    for value in (2.0, -1e-9, 1.0):
        assert gate.command(only(2, value), 0.01) == ZERO
    assert (gate.armed, gate.fault, gate.holding) == (True, None, True)
    assert gate.command(ZERO, 0.02) == ZERO
    gate.release()
    assert gate.command(only(2, 1.0), 0.03) == only(2, 1.0)


@pytest.mark.parametrize('bad', [(math.nan, 0, 0, 0), (0, math.inf, 0, 0), (2.1, 0, 0, 0)])
def test_a_bad_command_trips_though_the_gate_holds(bad):
    gate = armed()
    gate.hold()
    assert gate.command(bad, 0.01) == ZERO
    assert tripped(gate, Reason.LIMIT if bad[0] == 2.1 else Reason.MALFORMED)
    assert not gate.holding
    gate.hold()  # a gate that is disarmed holds nothing
    assert not gate.holding


def test_who_never_commands_zero_loses_the_permission():
    gate = armed(Limits(**{**vars(LIMITS), 'feedback_timeout_s': 1e3}))
    gate.hold()
    for now in (16.0, 32.0, 64.0):
        assert gate.command(only(0, 1.0), now) == ZERO
    assert gate.armed
    assert gate.command(only(0, 1.0), math.nextafter(64.0, 65.0)) == ZERO
    assert tripped(gate, Reason.IDLE)
    assert gate.fault.detail == 'no command of zero for 64 s'


PATIENT = Limits(**{**vars(LIMITS), 'feedback_timeout_s': 1e3, 'idle_s': 1e3})


@pytest.mark.parametrize(('before_s', 'attended'), [
    (0.0, True), (3.0, True), (3.001, False), (50.0, False), (math.inf, False)])
def test_it_is_attended_where_a_heartbeat_came_just_before_arming(before_s, attended):
    gate = Gate(PATIENT)
    gate.measured(ZERO, 100.0 - min(before_s, 100.0))
    gate.attend(100.0 - before_s)
    gate.measured(ZERO, 100.0)
    assert gate.arm(100.0) is None
    gate.tick(103.0 - min(before_s, 3.0))
    assert gate.armed
    gate.tick(math.nextafter(103.0, 104.0))
    assert gate.armed != attended


@pytest.mark.parametrize(('pause_s', 'holds'), [
    (0.1, True), (3.0, True), (math.nextafter(3.0, 4.0), False), (1e3, False)])
def test_an_attended_gate_lives_by_heartbeats(pause_s, holds):
    gate = armed(PATIENT)
    gate.attend(0.0)
    gate.tick(pause_s)
    assert holds == gate.armed
    assert holds or tripped(gate, Reason.UNATTENDED)


def test_who_stays_away_is_told_for_how_long():
    gate = armed(PATIENT)
    gate.attend(1.0)
    gate.tick(5.25)
    assert gate.fault.detail == 'no operator heartbeat for 4.2 s'


def swinging(**limits):
    return driving((1.0, 0.0, 0.0, 0.0), Limits(**{
        **vars(LIMITS), 'current_A': 2.0, 'step_A': 3.0, 'slew_A_per_s': 10.0, **limits}))


@pytest.mark.parametrize('coil', COILS)
@pytest.mark.parametrize(('largest', 'within'), around(2.0))
def test_what_a_device_turns_stays_within_the_limit(coil, largest, within):
    gate = swinging()
    gate.swing(only(coil, largest), ZERO, 1.0)
    assert gate.armed == within
    assert within or tripped(gate, Reason.LIMIT if math.isfinite(largest) else Reason.MALFORMED)


@pytest.mark.parametrize(('amplitude', 'rate', 'within'), [
    (1.5, 1.0, True), (math.nextafter(1.5, 2), 1.0, False), (0.0, 1e9, True),
    (1.0, 5 * math.pi, True), (1.0, -5 * math.pi, True), (1.0, 5.01 * math.pi, False),
    (1.0, -5.01 * math.pi, False), (-1.6, 1.0, False), (-1.0, 5.01 * math.pi, False)])
def test_what_a_device_turns_is_no_faster_than_the_slew_limit(amplitude, rate, within):
    """A sine of amplitude I and frequency f changes by 4 I f a second, and by 2 I in a half turn.
    """
    gate = swinging()
    flows = gate.output
    assert gate.swing(ZERO, only(3, amplitude), rate) == (flows if within else ZERO)
    assert gate.armed == within
    assert within or tripped(gate, Reason.SLEW)


def test_a_swing_that_is_too_fast_is_told_in_turns():
    gate = swinging()
    gate.swing(ZERO, only(3, 1.0), -6.0 * math.tau)
    assert gate.fault.detail == '±(0, 0, 0, 1) A rotating at 6 Hz exceeds the step or slew limit'


@pytest.mark.parametrize(('amplitude', 'rate'), [
    (math.nan, 1.0), (math.inf, 1.0), (1.0, math.nan), (1.0, math.inf), (1.0, -math.inf)])
def test_a_swing_that_is_no_number_trips(amplitude, rate):
    gate = swinging()
    assert gate.swing(ZERO, only(0, amplitude), rate) == ZERO
    assert tripped(gate, Reason.MALFORMED)


def test_a_disarmed_gate_lets_nothing_swing():
    gate = swinging()
    gate.revoke()
    assert gate.swing(ZERO, ZERO, 1.0) == ZERO
    assert gate.fault is None


@pytest.mark.parametrize('heat', [0.0, 0.5, 1.0, math.nextafter(1.0, 2.0)])
def test_the_heat_of_before_is_where_it_begins_and_cools(heat):
    gate = Gate(PATIENT, heat=(0.0, heat, 0.0, 0.0))
    gate.measured(ZERO, 1000.0)
    assert gate.heat == only(1, heat)
    assert bool(gate.arm(1000.0)) == (heat > 1.0)
    gate.tick(1000.0 + LIMITS.thermal_s)
    assert gate.heat[1] == pytest.approx(heat / math.e)


def test_a_machine_that_was_suspended_finds_a_stale_command_and_a_hot_coil():
    gate = driving((1.5, 0.0, 0.0, 0.0))
    gate.measured((1.5, 0.0, 0.0, 0.0), 0.1)
    assert gate.command((1.5, 0.0, 0.0, 0.0), 3600.0) == ZERO  # CLOCK_BOOTTIME went on
    assert gate.heat[0] == pytest.approx(1.5**2)
    assert gate.fault is not None


def test_readings_that_come_late_are_no_fault_of_the_coils_but_of_the_line():
    gate = driving((1.0, -1.0, 0.5, 0.0))
    for step in range(1, 9):  # what was measured 0.125 s ago, again and again
        now = step * 0.03125
        gate.command((1.0, -1.0, 0.5, 0.1 * step), now)
        gate.measured((0.0,) * 4, now)
    assert gate.armed
    gate.command((1.0, -1.0, 0.5, 0.9), math.nextafter(0.28125, 1))
    assert tripped(gate, Reason.SILENCE)
    assert gate.fault.detail.startswith('the readings of the last 0.250 s are of commands '
                                        'older than 0.219 s')


def test_one_present_reading_makes_up_for_late_ones():
    gate = driving((1.0,) * 4, Limits(**{**vars(LIMITS), 'command_timeout_s': 10.0}))
    gate.measured(ZERO, 0.125)
    gate.measured((1.0,) * 4, 0.125)
    gate.measured(ZERO, 0.25)
    assert gate.tick(0.375) != ZERO
    assert gate.tick(math.nextafter(0.375, 1)) == ZERO
    assert tripped(gate, Reason.SILENCE)


@pytest.mark.parametrize(('current', 'moment', 'reason'), [
    (1.0, 1.0, Reason.SILENCE), (1.0, 1.0625, Reason.SILENCE),
    (1.0, math.nextafter(1.0625, 2), Reason.UNCOMMANDED), (1.5, 1.0, Reason.UNCOMMANDED),
    (-1.0, 1.0, Reason.UNCOMMANDED)])
def test_a_device_that_stood_still_first_does_as_it_did(current, moment, reason):
    """Silent from 0.03 s to 1 s, so disarmed: it has yet to read the zero that waits for it."""
    gate = driving((1.0,) * 4)
    gate.measured((1.0,) * 4, 0.03)
    gate.command((0.9,) * 4, 0.04)
    gate.tick(0.3)
    gate.sent(0.3)
    assert tripped(gate, Reason.SILENCE)
    gate.measured((0.95,) * 4, 1.0)  # on its way from one to the other
    gate.measured((current,) * 4, moment)
    assert tripped(gate, reason)
    gate.measured(ZERO, 1.07)
    assert gate.arm(1.07) is None


@pytest.mark.parametrize(('sent_s', 'reason'), [
    (math.nextafter(0.0625, 1), Reason.SILENCE), (0.0625, Reason.UNCOMMANDED)])
def test_before_it_stood_still_it_may_not_have_settled(sent_s, reason):
    """What was replaced before the last reading counts as long as it may have been settling."""
    gate = driving((1.0,) * 4)
    gate.measured((1.0,) * 4, 0.03)
    gate.command((0.4,) * 4, sent_s)
    gate.sent(sent_s)
    gate.measured((0.4,) * 4, 0.125)
    gate.tick(0.4)
    gate.sent(0.4)
    assert tripped(gate, Reason.SILENCE)
    gate.measured((1.0,) * 4, 1.0)
    assert tripped(gate, reason)


def test_readings_a_time_out_apart_are_no_silence():
    gate = driving((1.0,) * 4)
    gate.measured((1.0,) * 4, 0.1)
    gate.trip(Reason.LINE, 'pulled')
    gate.sent(0.2)
    for moment in 0.25, 0.5:
        gate.measured(ZERO, moment)
    gate.measured((1.0,) * 4, 0.55)
    assert tripped(gate, Reason.UNCOMMANDED)


@pytest.mark.parametrize('coil', COILS)
def test_one_coil_that_does_not_follow_is_not_late(coil):
    gate = driving((1.0,) * 4)
    measured = [1.0] * 4
    measured[coil] = 0.0
    assert gate.measured(measured, math.nextafter(0.0625, 0)) != ZERO
    assert gate.measured(measured, 0.0625) == ZERO
    assert tripped(gate, Reason.DEVIATION)


@pytest.mark.parametrize(('since', 'agrees'), [
    (0.1, False), (math.nextafter(0.0625, 1), False), (0.0625, False),
    (math.nextafter(0.0625, 0), True), (0.0, True), (-10.0, True), (1e9, False),
    *((value, value == -math.inf) for value in NOT_FINITE),
])
def test_a_slow_line_is_judged_by_what_it_had_then(since, agrees):
    gate = driving((1.0,) * 4)
    reading = (1.0, 0.5, 0.0, 1.0)  # of which two coils have heard
    assert (gate.measured(reading, 0.1, since) != ZERO) == agrees
    assert agrees or tripped(gate, Reason.DEVIATION)


@pytest.mark.parametrize(('given', 'holds'), [
    (0.25, True), (0.2, True), (0.125, True), (0.125 - 1e-12, False), (0.0, False),
    (1e9, True), (math.nan, False), (-math.inf, False), (math.inf, True),
])
def test_a_command_is_as_old_as_when_it_was_given(given, holds):
    gate = armed()
    gate.measured(ZERO, 0.25)
    assert gate.command(only(2, 0.5), 0.25, given) == (only(2, 0.5) if holds else ZERO)
    assert holds or tripped(gate, Reason.STALE)
    if holds:
        lasts_until = min(given, 0.25) + 0.125
        assert gate.tick(lasts_until) != ZERO
        assert gate.tick(math.nextafter(lasts_until, 1)) == ZERO


@pytest.mark.parametrize('commanded', [None, ZERO, (0.5,) * 4])
@pytest.mark.parametrize(('age', 'holds'), [
    (64.0, True), (math.nextafter(64.0, 65), False), (1e6, False)])
def test_the_permission_ends_when_nobody_commands(commanded, age, holds):
    limits = Limits(**{**vars(LIMITS), 'command_timeout_s': 1e9, 'feedback_timeout_s': 1e9})
    gate = armed(limits)
    if commanded is not None:
        gate.measured(ZERO, 1.0)
        gate.command(commanded, 1.0)
        age += 1.0
    gate.tick(age)
    assert gate.armed == holds
    assert holds or tripped(gate, Reason.IDLE)
    assert holds or gate.fault.detail == f'no command for {age - (commanded is not None):.0f} s'


def test_arming_again_starts_the_time_without_commands_anew():
    gate = armed()
    gate.revoke()
    gate.measured(ZERO, 60.0)
    assert gate.arm(60.0) is None
    for now in np.arange(60.0, 124.0, 0.25):
        gate.measured(ZERO, now)
    gate.tick(124.0)
    assert gate.armed


@pytest.mark.parametrize('name', vars(LIMITS))
@pytest.mark.parametrize('value', [0.0, -1.0, *NOT_FINITE])
def test_a_limit_that_limits_nothing_is_refused(name, value):
    with pytest.raises(ValueError, match=name):
        Limits(**{**vars(LIMITS), name: value})


def test_random_commands_never_break_a_limit():
    random = np.random.default_rng(3)
    gate = armed()
    now, history = 0.0, []
    for _ in range(8_000):
        now += float(random.exponential(0.01))
        gate.measured(gate.output, now)
        if not gate.armed and gate.arm(now) is None:
            history.append((now, ZERO))
        scale = random.choice([0.1, 1.0, 2.0, 3.0])
        history.append((now, gate.command(random.normal(0, scale, 4), now)))
    times = np.array([t for t, _ in history])
    currents = np.array([out for _, out in history])
    assert np.all(np.abs(currents) <= 2.0)
    assert np.count_nonzero(currents.any(axis=1)) > 1000
    rise = np.maximum(np.abs(currents[1:]) - np.abs(currents[:-1]), 0)  # a fall may be a trip
    for window in (1, 2, 3, 10):
        total = np.array([rise[i:i + window].sum(axis=0) for i in range(len(rise) - window)])
        lasted = (times[window:] - times[:-window])[:len(total), None]
        assert np.all(total <= 3.0 + 10.0 * lasted + 1e-9)


def test_without_feedback_it_keeps_every_rule_but_those_of_measurement():
    limits = dataclasses.replace(LIMITS, command_timeout_s=32.0)
    gate = Gate(limits, feedback=False)
    assert gate.arm(0.0) is None
    assert gate.command(only(0, 1.0), 0.0) == only(0, 1.0)
    assert gate.tick(4.0) == only(0, 1.0)  # sixteen times what silence may last
    assert gate.command(only(0, 2.0), 4.0) == only(0, 2.0)
    # I²t of what was commanded: 1 − e^(−½), then towards 4 with the same constant.
    heated = 4.0 + 8.0 * math.log((4 - (1 - math.exp(-0.5))) / 3)
    assert gate.tick(math.nextafter(heated, 0) - 1e-9) == only(0, 2.0)
    assert gate.tick(heated + 1e-9) == ZERO
    assert tripped(gate, Reason.HEAT)
    assert 'thermal limit' in gate.arm(heated + 1e-9)
    for wanted, reason in ((only(1, math.nan), Reason.MALFORMED), (only(1, 2.5), Reason.LIMIT)):
        gate = Gate(LIMITS, feedback=False)
        assert gate.arm(0.0) is None
        assert gate.command(wanted, 0.0) == ZERO
        assert tripped(gate, reason)
    gate = Gate(LIMITS, feedback=False)
    gate.arm(0.0)
    gate.command(only(1, 1.0), 0.0)
    assert gate.tick(0.126) == ZERO
    assert tripped(gate, Reason.STALE)


@pytest.mark.parametrize('lapsed_s', [None, 1.0, math.nan])
@pytest.mark.parametrize('reading', [0.0, 0.5, -0.25, 1.25, -0.2501, 1.2501])
def test_a_lapse_explains_currents_down_to_zero_until_they_had_time_to_settle(lapsed_s, reading):
    gate = driving(only(0, 1.0))
    for now in np.arange(0.0625, 1.0625, 0.0625):  # until the zero before it is forgotten
        gate.measured(only(0, 1.0), now)
        gate.command(only(0, 1.0), now)
    if lapsed_s is not None:
        gate.lapse(lapsed_s)
    agrees = 0.75 <= reading <= 1.25
    explained = lapsed_s == 1.0 and -0.25 <= reading <= 1.25
    passes = gate.measured(only(0, reading), math.nextafter(1.0625, 0)) != ZERO
    assert passes == (agrees or explained)
    assert passes or tripped(gate, Reason.DEVIATION)
    assert (gate.measured(only(0, reading), 1.0625) != ZERO) == agrees


def test_what_a_lapse_explains_measures_nothing():
    gate = driving(only(0, 1.0))
    now = 0.0
    while gate.armed:
        now += 0.03125
        gate.command(only(0, 1.0), now)
        gate.lapse(now)
        gate.measured(only(0, 0.5), now)
    assert tripped(gate, Reason.SILENCE)
    assert 0.25 < now < 0.375


def test_without_readings_nothing_is_kept_for_them():
    gate = Gate(LIMITS, 4, feedback=False)
    assert gate.arm(0.0) is None
    for k in range(1, 500):
        gate.command((math.cos(k / 48), math.sin(k / 48), 0.0, 0.0), k / 48)
        gate.sent(k / 48)
    assert gate.armed
    assert not gate._replaced
