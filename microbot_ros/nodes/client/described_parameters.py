"""Parameters of a node from their descriptors, for a page that shows and sets them."""

from __future__ import annotations

import array
from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor

from microbot_ros.common import units

_TYPES: tuple[tuple[type, str, str], ...] = (
    (bool, 'boolean', ''), (int, 'integer', 'numbers'), (float, 'number', 'numbers'),
    (str, 'text', 'texts'))
"""Name on the page of a type in Python, and of a list of it."""
_OWN_VERB = 'controller'
"""Parameter that selects the controller; the page has a separate command for it."""
_OF_ROS = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


class Described:
    """Parameters of the controller that may be shown, with descriptors and values.

    Parameters of ROS itself and names of files, which a browser must not set, are left out.

    Parameters
    ----------
    descriptors : sequence of ParameterDescriptor
        Descriptors of all parameters.
    """

    def __init__(self, descriptors: Sequence[ParameterDescriptor]) -> None:
        self._descriptors = {
            one.name: one for one in descriptors
            if not one.name.startswith(_OF_ROS) and one.name != _OWN_VERB
            and not one.name.rpartition('.')[2].endswith('file')}
        self._values: dict[str, Any] = {}
        self._types: dict[str, str] = {}

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self._descriptors)

    def with_values(self, values: Sequence[Any]) -> Described:
        """Set new values.

        Parameters
        ----------
        values : sequence of object
            Values in the order of the names.

        Returns
        -------
        Described
            This object.
        """
        self._values = {name: _plain(value)
                        for name, value in zip(self.names, values, strict=True)}
        for name, value in self._values.items():
            # A number may be set to an integer value without becoming one.
            if self._types.get(name) != 'number':
                self._types[name] = _type(value, self._descriptors[name])
        return self

    def of(self, controller: str) -> list[dict[str, Any]]:
        """Return the parameters of the manager and of a controller, as the page receives them.

        Parameters
        ----------
        controller : str
            Name of the controller.

        Returns
        -------
        list of dict of str to object
            One dictionary per parameter.
        """
        return [self._entry(name) for name in self._values
                if '.' not in name or name.startswith(f'{controller}.')]

    def converted(self, name: str, value: Any) -> Any:
        """Return a value in the type of its parameter.

        Parameters
        ----------
        name : str
            Name of the parameter.
        value : object
            Value from the page.

        Returns
        -------
        object
            Value for the node.

        Raises
        ------
        ValueError
            If the parameter is unknown or fixed, or the value of another type.
        """
        descriptor = self._descriptors.get(name)
        if descriptor is None:
            raise ValueError(f'{name} is no parameter of the controller')
        if descriptor.read_only:
            raise ValueError(f'{name} is fixed at start-up')
        return _converted(name, self._types[name], value)

    def _entry(self, name: str) -> dict[str, Any]:
        descriptor = self._descriptors[name]
        least, most = _range(descriptor)
        return {
            'name': name, 'type': self._types[name], 'value': self._values[name],
            'minimum': least, 'maximum': most, 'unit': units.symbol(name.rpartition('.')[2]),
            'description': descriptor.description, 'read_only': descriptor.read_only}


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, array.array | tuple) else value


def _type(value: Any, descriptor: ParameterDescriptor) -> str:
    """Return the page's name of the type of a parameter."""
    if descriptor.floating_point_range:
        return 'number'
    if isinstance(value, list):
        return 'texts' if any(isinstance(item, str) for item in value) else 'numbers'
    return next((name for kind, name, _ in _TYPES if type(value) is kind), 'text')


def _converted(name: str, kind: str, value: Any) -> Any:
    """Return the value of a parameter in its type; ValueError for another type."""
    if kind == 'numbers' and isinstance(value, list):
        return [_converted(name, 'number', item) for item in value]
    if kind == 'number' and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    expected = {'boolean': bool, 'integer': int, 'number': float, 'text': str}.get(kind)
    right = (isinstance(value, list) and all(isinstance(item, str) for item in value)
             if expected is None else type(value) is expected)
    if not right:
        raise ValueError(f'{name} must be of the type {kind}')
    return value


def _range(descriptor: ParameterDescriptor) -> tuple[float | None, float | None]:
    """Return lowest and highest value, None if unlimited."""
    for one in (*descriptor.floating_point_range, *descriptor.integer_range):
        return one.from_value, one.to_value
    return None, None
