"""Requests of a page: each verb with its arguments, checked before any node receives it."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, ClassVar, Literal, get_args, get_type_hints

from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.rig import Answer, Rig
from microbot_ros.common.checked import Field, Settings, SettingsError, checked
from microbot_ros.common.errors import one_line
from microbot_ros.common.plausible import plausible_range

_LONGEST_PATH = 2000
"""Most points of a path. Choice: far more than a hand draws; twice doubles the longest message."""
_LONGEST_TEXT = 2000
"""Most characters of a text. Choice: a page of notes."""

_FARTHEST_UM = plausible_range('x_um')[1]
"""Largest coordinate [µm], that of the plausible range of recorded data."""
_LARGEST_PX = plausible_range('x_px')[1]
"""Largest pixel coordinate, that of the plausible range of recorded data."""
Micrometres = Annotated[float, Field(ge=-_FARTHEST_UM, le=_FARTHEST_UM)]
Pixels = Annotated[float, Field(ge=-_LARGEST_PX, le=_LARGEST_PX)]
Deflection = Annotated[float, Field(ge=-1.0, le=1.0)]
Text = Annotated[str, Field(max_length=_LONGEST_TEXT)]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r'^[\w.]+$')]
Stamp = Annotated[str, Field(pattern=r'^[0-9]{1,20}$')]
_Number = Annotated[int, Field(ge=-(2**53), le=2**53)]
_Scalar = bool | _Number | float | Text


class Verb(Settings):
    """Message of a page; `id` is returned with the answer."""

    needs_control: ClassVar[bool] = True
    id: Annotated[int, Field(ge=0, le=2**53)] | None = None


class Seen(Verb):
    """A picture was drawn, or skipped."""

    needs_control = False
    verb: Literal['seen']
    stamp: Stamp


class Heartbeat(Verb):
    """An operator is present."""

    needs_control = False
    verb: Literal['heartbeat']


class Stick(Verb):
    """Present position of the joystick, or of keys."""

    verb: Literal['stick']
    x: Deflection
    y: Deflection


class TakeControl(Verb):
    """Request for control."""

    needs_control = False
    verb: Literal['take_control']


class Order(Verb):
    """Verb that ends with an answer."""


class Stop(Order):
    """Zero the coils, from any page; the server sends it by `Stopping`."""

    needs_control = False
    verb: Literal['stop']


class Arm(Order):
    """Let currents flow; if `attended`, only while a page is present."""

    verb: Literal['arm']
    attended: bool


class Disarm(Order):
    """Zero the coils, as `Stop`, by the page in control."""

    verb: Literal['disarm']


class Goal(Order):
    """Place to go to."""

    verb: Literal['goal']
    x_um: Micrometres
    y_um: Micrometres
    particle: Annotated[int, Field(ge=0, lt=2**32)] | None = None


class ClearGoals(Order):
    """Cancel the goals and the path."""

    verb: Literal['clear_goals']


class Path(Order):
    """Path to follow."""

    verb: Literal['path']
    points_um: Annotated[
        list[Annotated[list[Micrometres], Field(min_length=2, max_length=2)]],
        Field(min_length=2, max_length=_LONGEST_PATH)]


class SwitchController(Order):
    """Switch to another controller."""

    verb: Literal['switch_controller']
    name: Name


class Set(Order):
    """Set a parameter of the controllers."""

    verb: Literal['set']
    name: Name
    value: _Scalar | Annotated[list[_Scalar], Field(max_length=1000)]


class Teach(Order):
    """Show an example of a particle, or of something else."""

    verb: Literal['teach']
    x_px: Pixels
    y_px: Pixels
    stamp: Stamp
    example: Literal['like', 'unlike']
    particle_kind: Annotated[str, Field(pattern=r'^[^\s,@]{1,40}$')] | None = None


class Record(Order):
    """Begin or end a recording."""

    verb: Literal['record']
    on: bool
    title: Text = ''


class Note(Order):
    """Add a line to the present recording."""

    verb: Literal['note']
    text: Annotated[str, Field(min_length=1, max_length=_LONGEST_TEXT)]


class Discover(Order):
    """Begin or end a discovery, which drives the rig to find what the model lacks."""

    verb: Literal['discover']
    on: bool
    minutes: Annotated[float, Field(ge=0.5, le=600.0)] = 10.0


AnyVerb = (
    Seen | Heartbeat | Stick | TakeControl | Stop | Arm | Disarm | Goal | ClearGoals | Path
    | SwitchController | Set | Teach | Record | Note | Discover)
_VERBS: dict[str, type[AnyVerb]] = {
    get_args(get_type_hints(kind)['verb'])[0]: kind for kind in get_args(AnyVerb)}
"""Class of each verb by its name in the protocol."""

NAMES = tuple(_VERBS)
"""Names of the verbs in the protocol."""


_METHODS: dict[type[Verb], Callable[[Any, Rig, Discovery], Awaitable[Answer]]] = {
    Arm: lambda _verb, rig, _: rig.arm(),
    Goal: lambda verb, rig, _: rig.goal(verb.x_um, verb.y_um, verb.particle),
    ClearGoals: lambda _verb, rig, _: rig.clear_goals(),
    Path: lambda verb, rig, _: rig.path([(x, y) for x, y in verb.points_um]),
    SwitchController: lambda verb, rig, _: rig.switch_controller(verb.name),
    Set: lambda verb, rig, _: rig.set(verb.name, verb.value),
    Teach: lambda verb, rig, _: rig.teach(
        verb.example == 'like', verb.x_px, verb.y_px, verb.particle_kind, int(verb.stamp)),
    Record: lambda verb, rig, _: rig.record(verb.on, one_line(verb.title)),
    Note: lambda verb, rig, _: rig.note(one_line(verb.text)),
    Discover: lambda verb, rig, discovery: (
        discovery.start(verb.minutes, rig.state().get('rig')) if verb.on else discovery.stop())}
"""Action of each verb; the server performs STOP and the verbs without answer."""


async def perform(verb: Order, rig: Rig, discovery: Discovery) -> Answer:
    """Perform a verb.

    Parameters
    ----------
    verb : Order
        The verb.
    rig : Rig
        The rig.
    discovery : Discovery
        The discovery.

    Returns
    -------
    Answer
        Answer of the node.

    Raises
    ------
    RefusedError
        If it is refused, with the reason.
    """
    return await _METHODS[type(verb)](verb, rig, discovery)


def told(verb: Order) -> str:
    """Return a verb as text for people, with its values.

    Parameters
    ----------
    verb : Order
        The verb.

    Returns
    -------
    str
        The text.
    """
    match verb:
        case Arm():
            return 'Arm, attended' if verb.attended else 'Arm'
        case Stop():
            return 'STOP'
        case Goal():
            whose = '' if verb.particle is None else f' for particle {verb.particle}'
            return f'Goal at {verb.x_um:.1f}, {verb.y_um:.1f} µm{whose}'
        case Path():
            return f'Path through {len(verb.points_um)} points'
        case SwitchController():
            return f'Switch to {verb.name.replace("_", " ")}'
        case Set():
            return f'Set {verb.name} to {verb.value}'
        case Teach():
            not_ = '' if verb.example == 'like' else 'not '
            return f'Teach: {not_}this at {verb.x_px:.0f}, {verb.y_px:.0f} px'
        case Record():
            title = f' “{one_line(verb.title)}”' if verb.title and verb.on else ''
            return f'Record{title}' if verb.on else 'Stop recording'
        case Note():
            return f'Note “{one_line(verb.text)}”'
        case Discover():
            return f'Discover for {verb.minutes:g} min' if verb.on else 'Stop discovery'
    return type(verb).__name__.replace('Goals', ' goals')


class VerbError(ValueError):
    """Error of a text that is no verb.

    Parameters
    ----------
    text : str
        The text.
    reason : str
        Why, in one sentence.
    """

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(one_line(reason))
        self.id = _id_in(text)


def read_verb(text: str) -> AnyVerb:
    """Return the verb in a text of a page.

    Parameters
    ----------
    text : str
        The text.

    Returns
    -------
    Verb
        The verb.

    Raises
    ------
    VerbError
        If it is anything else.
    """
    try:
        content = checked(dict[str, Any], json.loads(text))
        name = content.get('verb')
        if name not in NAMES:
            raise SettingsError(f'expected one of: {", ".join(NAMES)}', 'verb', received=name)
        return _VERBS[name].from_content(content)
    except (ValueError, RecursionError) as error:
        raise VerbError(text, str(error)) from None


def _id_in(text: str) -> int | None:
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        return None
    found = content.get('id') if isinstance(content, dict) else None
    return found if type(found) is int else None
