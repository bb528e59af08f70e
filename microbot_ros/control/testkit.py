"""Tests that every controller must pass; call it in a test of your own package.

    from microbot_ros.control.testkit import exercise

    def test_my_controller_keeps_the_contract():
        exercise(MyController)

It needs no rig.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from microbot_ros.common import settings
from microbot_ros.common.records import Commands
from microbot_ros.control.contract import (
    INTERFACE_VERSION,
    Controller,
    ControllerError,
    ControllerInput,
    Goals,
    Input,
    Limits,
    Workspace,
)

_PLACES = np.array([[20e-6, 10e-6], [-30e-6, 0], [0, 40e-6]])
"""Choice: goals [m] well inside the view and apart from each other."""
_MORE: dict[Input, dict[str, Any]] = {
    Input.GOALS: {'goals': Goals(_PLACES)},
    Input.PARTICLE_GOALS: {'goals': Goals(_PLACES[:2], np.array([2, 0]))},
    Input.PATH: {'path': np.column_stack((np.linspace(-50e-6, 50e-6, 21), np.zeros(21)))},
    Input.PLAN: {'plan': Commands(np.array([0.0, 60.0]), np.array([[1e-3, 0.0], [0.0, 0.0]]))},
    Input.JOYSTICK: {'joystick': np.array([0.6, 0.8])}}
"""Choice: a plausible input of each kind."""

VIEW = Workspace(np.array([-144e-6, -108e-6]), np.array([144e-6, 108e-6]))
"""Workspace [m]: 640 × 480 pixels of 0.45 µm, the picture of the virtual microscope."""


def controller_input(
    count: int = 3, t: float = 0.0, seed: int = 0, **changes: Any) -> ControllerInput:
    """Return a plausible input with `count` known particles; `changes` replaces its fields.

    `expected` is the measured position, as for a rig without delay; `t` [s] is the present time,
    `seed` selects the particles.

    Parameters
    ----------
    count : int
        Number of particles.
    t : float
        Present time [s].
    seed : int
        Seed of the particles.
    **changes : object
        Values of fields.

    Returns
    -------
    ControllerInput
        The input.
    """
    rng = np.random.default_rng(seed)
    position = rng.uniform(-60e-6, 60e-6, (count, 2))
    values: dict[str, Any] = {
        't': t, 'dt': 1 / 60, 'age': 0.01, 'ids': np.arange(count), 'position': position,
        'sigma': np.full(count, 5e-8), 'theta': rng.uniform(-np.pi, np.pi, count),
        'speed': rng.uniform(3e-6, 5e-6, count), 'phi': rng.uniform(-np.pi, np.pi, count),
        'speed_std': np.full(count, 1e-7), 'phi_std': np.full(count, 0.02),
        'limits': Limits(), 'workspace': VIEW, 'delay': 0.03, 'expected': position,
    }
    return ControllerInput(**values | changes)


def exercise(kind: type[Controller]) -> None:
    """Raise AssertionError, naming the defect, unless controllers of a `kind` keep the contract.

    A controller must state version, summary, inputs and described parameters; use no input that it
    does not take; accept its default parameters; and answer each of a series of inputs, common and
    odd, with a finite command within the limits or with a ControllerError, without changing the
    inputs; also after `reset` and a second activation.

    Parameters
    ----------
    kind : type[Controller]
        Class of the controller.
    """
    assert kind.interface_version == INTERFACE_VERSION, 'written for another interface version'
    assert kind.summary.strip(), 'has no summary'
    assert kind.takes is not None, "does not state its inputs: 'takes = frozenset({Input.GOALS})'"
    assert set(kind.takes) <= set(Input), f"'takes' must hold members of Input: {kind.takes}"
    for name in settings.defaults(kind.Parameters):
        assert settings.about(kind.Parameters, name).description, f'{name} has no description'
    _acts_on_nothing_else(kind)
    controller = kind()
    controller.configure(kind.Parameters())
    for prepare in (controller.deactivate, controller.reset, controller.deactivate):
        for shown in odd_inputs():
            _answer(controller, shown)
        prepare()


def _acts_on_nothing_else(kind: type[Controller]) -> None:
    """Raise AssertionError if results depend on inputs that the controller does not take."""
    if not kind.repeatable:
        return  # even equal inputs may give different commands
    for what in Input:
        if not kind.accepts(what):
            with_it, without = (_answers(kind, what, given) for given in (True, False))
            assert with_it == without, f"acts on {what.value}, which is not among its 'takes'"


def _answers(kind: type[Controller], what: Input, given: bool) -> list[Any]:
    """Return the commands of a controller for some inputs, with or without one more."""
    controller, answers = kind(), list[Any]()
    controller.configure(kind.Parameters())
    for k in range(4):
        shown = controller_input(t=0.02 * k, **_MORE[what] if given else {})
        try:
            controller.activate(shown)
            command = controller.compute(shown)
            answers.append((np.asarray(command.field).tolist(), command.frequency))
        except ControllerError as error:
            answers.append(error.result)
    return answers


def odd_inputs() -> Iterator[ControllerInput]:
    """Yield inputs that occur on a rig, common and odd.

    Yields
    ------
    ControllerInput
        The input.
    """
    goals = Goals(np.array([[20e-6, 10e-6], [-30e-6, 0], [0, 40e-6]]))
    path = np.column_stack((np.linspace(-50e-6, 50e-6, 21), np.zeros(21)))
    nobody = controller_input(0)
    unknown: dict[str, Any] = {'speed': np.full(3, np.nan), 'phi': np.full(3, np.nan),
               'speed_std': np.full(3, np.inf), 'phi_std': np.full(3, np.inf)}
    yield controller_input()
    for t in (0.02, 0.04, 5.0):
        yield controller_input(t=t, goals=goals, path=path)
    yield controller_input(t=6, goals=goals, path=path, **unknown)
    yield dataclasses.replace(nobody, t=7, goals=goals, path=path)
    yield controller_input(1, t=8, goals=goals, path=path)
    yield controller_input(10, t=9, goals=goals, path=path)
    yield controller_input(t=10, goals=Goals(np.array([[1.0, 0.0]])), path=np.array([[1.0, 0.0]]))
    nowhere = np.full((3, 2), np.nan)
    yield controller_input(t=11, goals=Goals(nowhere[:2]), path=nowhere)
    yield controller_input(t=12, goals=Goals(goals.position, np.array([7, 8, 9])), path=path[:1])
    here = controller_input(t=13)
    yield dataclasses.replace(here, goals=Goals(here.position), path=here.position)
    yield controller_input(t=14, goals=goals, path=path, limits=Limits(field=1e-4, frequency=1.0))
    yield controller_input(t=15, dt=0.0, joystick=np.array([1.0, 0.0]), goals=goals)


def _answer(controller: Controller, shown: ControllerInput) -> None:
    before = {name: value.tobytes() for name, value in vars(shown).items()
              if isinstance(value, np.ndarray)}
    command, reason = None, ''
    try:
        controller.activate(shown)
        command = controller.compute(shown)
    except ControllerError as error:
        reason = str(error)
    assert command or reason, 'raises an error without a message'
    if command:
        field = np.asarray(command.field, dtype=float)
        assert field.shape in ((2,), (3,)), f'field of shape {field.shape} at t = {shown.t:g} s'
        assert np.linalg.norm(field) <= shown.limits.field * (1 + 1e-9), (
            f'field {field} T exceeds the limit')
        assert 0 <= command.frequency <= shown.limits.frequency, f'{command.frequency} Hz'
    for name, content in before.items():
        assert getattr(shown, name).tobytes() == content, f'changed {name} of the input'
