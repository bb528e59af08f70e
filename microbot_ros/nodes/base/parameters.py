"""ROS parameters from one frozen dataclass per node, validated and replaced atomically."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping
from typing import Any, Generic, TypeVar

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from microbot_ros.common import settings
from microbot_ros.common.errors import InputError, clipped, known

ValuesT = TypeVar('ValuesT')


class ParameterSet(Generic[ValuesT]):
    """Parameters of a node, or of a part of it under a prefix.

    A change is accepted whole or refused whole with a reason, over all sets of the node: first
    each value is checked against its range, then each set's `veto` is asked, neither of which has
    effects. Then the first set's `take` hands the new values to the code that uses them, and may
    refuse as well if it leaves everything unchanged. `values` change only after that.

    Parameters
    ----------
    node : Node
        The node.
    kind : type[ValuesT]
        Dataclass of the parameters.
    veto : callable
        Function that returns why new values are refused; '' to accept.
    prefix : str
        Prefix of their names.
    take : callable
        Function that receives the new values of each set by prefix and the names that were set,
        and returns why they are refused.
    beside : ParameterSet[object] or None
        First set of the node; None for the first.

    Raises
    ------
    InputError
        If an initial value is refused.
    """

    def __init__(
        self,
        node: Node,
        kind: type[ValuesT],
        veto: Callable[[ValuesT], str] = lambda _: '',
        prefix: str = '',
        *,
        take: Callable[[Mapping[str, Any], Collection[str]], str] = lambda *_: '',
        beside: ParameterSet[Any] | None = None,
    ) -> None:
        self._kind = kind
        self._veto = veto
        self._take = take
        self.sets: dict[str, ParameterSet[Any]] = {} if beside is None else beside.sets
        """All sets of the node by their prefixes."""
        self._prefix = prefix
        initial = {}
        for name, default in settings.defaults(kind).items():
            override = node._parameter_overrides.get(prefix + name)
            # Checked before rclpy does, whose exceptions name neither unit nor range.
            value = default if override is None else override.value
            if value is None and isinstance(default, list):
                value = []  # what rcl makes of an empty list, which has no type
            initial[name] = self._converted(node, name, value)
            node.declare_parameter(prefix + name, initial[name], _descriptor(kind, name, default),
                                   ignore_override=True)
        self.values = kind(**initial)
        reason = veto(self.values)
        if reason:
            raise InputError(node.get_name(), reason)
        self.sets[prefix] = self
        if beside is None:
            node.add_on_set_parameters_callback(self._validate)
            node.add_post_set_parameters_callback(self._apply)

    def _converted(self, node: Node, name: str, value: Any) -> Any:
        try:
            return settings.convert(self._kind, name, value)
        except ValueError as error:
            raise InputError(node.get_name(), str(error)) from None

    def _changed(self, parameters: list[Parameter]) -> ValuesT:
        known = settings.defaults(self._kind)
        changes = {}
        for parameter in parameters:
            name = parameter.name.removeprefix(self._prefix)
            if parameter.name == self._prefix + name and name in known:
                changes[name] = settings.convert(self._kind, name, parameter.value)
        return dataclasses.replace(self.values, **changes)  # type: ignore[type-var]

    def _validate(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            proposed = {prefix: each._changed(parameters) for prefix, each in self.sets.items()}
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        changed = {prefix: values for prefix, values in proposed.items()
                   if values != self.sets[prefix].values}
        reasons = (self.sets[prefix]._veto(values) for prefix, values in changed.items())
        reason = next(filter(None, reasons), '')
        if not reason:
            reason = self._take(changed, {parameter.name for parameter in parameters})
        return SetParametersResult(successful=not reason, reason=reason)

    def _apply(self, parameters: list[Parameter]) -> None:
        for each in self.sets.values():
            each.values = each._changed(parameters)


def refuse_unknown(node: Node) -> None:
    """Refuse a parameter that was given but that the node does not have.

    rclpy ignores such overrides, and a misspelt limit would silently keep its default.

    Parameters
    ----------
    node : Node
        The node.

    Raises
    ------
    InputError
        If there is one.
    """
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith('qos_overrides.'):
            raise InputError(node.get_name(), f"unknown parameter '{clipped(name)}'; "
                                              f'{known(node._parameters, name)}')


def _descriptor(kind: type, name: str, default: Any) -> ParameterDescriptor:
    about = settings.about(kind, name)
    text = about.description
    if about.choices:
        text += f' One of: {", ".join(about.choices)}.'
    # Dynamic typing, so that `60` is taken where `60.0` is meant; `convert` holds the type.
    descriptor = ParameterDescriptor(
        name=name, description=text, read_only=about.read_only, dynamic_typing=True)
    if about.lower is not None and about.upper is not None:
        if isinstance(default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=float(about.lower), to_value=float(about.upper))]
        elif isinstance(default, int):
            descriptor.integer_range = [
                IntegerRange(from_value=int(about.lower), to_value=int(about.upper))]
    return descriptor
