"""What a page may ask for: each verb with what it takes, checked before anybody hears of it."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Annotated, Any, ClassVar, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic_core import from_json

from microbot_ros.cockpit.discovery import Discovery
from microbot_ros.cockpit.rig import Answer, Rig
from microbot_ros.common.errors import one_line, shown
from microbot_ros.common.plausible import plausible_range

_LONGEST_PATH = 2000
_LONGEST_TEXT = 2000

_FARTHEST_UM = plausible_range('x_um')[1]
_LARGEST_PX = plausible_range('x_px')[1]
Micrometres = Annotated[float, Field(ge=-_FARTHEST_UM, le=_FARTHEST_UM, allow_inf_nan=False)]
Pixels = Annotated[float, Field(ge=-_LARGEST_PX, le=_LARGEST_PX, allow_inf_nan=False)]
Deflection = Annotated[float, Field(ge=-1.0, le=1.0, allow_inf_nan=False)]
Text = Annotated[str, Field(max_length=_LONGEST_TEXT)]
Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r'^[\w.]+$')]
Stamp = Annotated[str, Field(pattern=r'^[0-9]{1,20}$')]
Finite = Annotated[float, Field(allow_inf_nan=False)]
_Number = Annotated[int, Field(ge=-(2**53), le=2**53)]
_Scalar = bool | _Number | Finite | Text


class Verb(BaseModel):
    """A message of a page; `id` comes back with the answer."""

    model_config = ConfigDict(extra='forbid', strict=True, frozen=True)
    needs_control: ClassVar[bool] = True
    id: Annotated[int, Field(ge=0, le=2**53)] | None = None


class Seen(Verb):
    """A picture was drawn, or skipped."""

    needs_control = False
    verb: Literal['seen']
    stamp: Stamp


class Heartbeat(Verb):
    """Somebody is there."""

    needs_control = False
    verb: Literal['heartbeat']


class Stick(Verb):
    """Where a stick, or keys, are now."""

    verb: Literal['stick']
    x: Deflection
    y: Deflection


class TakeControl(Verb):
    """The page is to have control."""

    needs_control = False
    verb: Literal['take_control']


class Order(Verb):
    """A verb that ends with an answer."""


class Stop(Order):
    """Zero the coils, whoever asks; the server sends it by `Stopping`."""

    needs_control = False
    verb: Literal['stop']


class Arm(Order):
    """Let currents flow; `attended`: only while a page is there."""

    verb: Literal['arm']
    attended: bool


class Disarm(Order):
    """Let none flow any more; as `Stop`, by the page in control."""

    verb: Literal['disarm']


class Goal(Order):
    """A place to go to."""

    verb: Literal['goal']
    x_um: Micrometres
    y_um: Micrometres
    particle: Annotated[int, Field(ge=0, lt=2**32)] | None = None


class ClearGoals(Order):
    """No place to go to any more."""

    verb: Literal['clear_goals']


class Path(Order):
    """A path to follow."""

    verb: Literal['path']
    points_um: Annotated[
        list[Annotated[list[Micrometres], Field(min_length=2, max_length=2)]],
        Field(min_length=2, max_length=_LONGEST_PATH)]


class SwitchController(Order):
    """Another controller is to drive."""

    verb: Literal['switch_controller']
    name: Name


class Set(Order):
    """A parameter of the controllers."""

    verb: Literal['set']
    name: Name
    value: _Scalar | Annotated[list[_Scalar], Field(max_length=1000)]


class Teach(Order):
    """A particle pointed at, or what is none."""

    verb: Literal['teach']
    x_px: Pixels
    y_px: Pixels
    stamp: Stamp
    example: Literal['like', 'unlike']
    particle_kind: Annotated[str, Field(pattern=r'^[^\s,@]{1,40}$')] | None = None


class Record(Order):
    """Begin a recording, or end it."""

    verb: Literal['record']
    on: bool
    title: Text = ''


class Note(Order):
    """A line for the recording that runs."""

    verb: Literal['note']
    text: Annotated[str, Field(min_length=1, max_length=_LONGEST_TEXT)]


class Discover(Order):
    """Look for what the model is missing by driving the rig, or stop looking."""

    verb: Literal['discover']
    on: bool
    minutes: Annotated[float, Field(ge=0.5, le=600.0, allow_inf_nan=False)] = 10.0


AnyVerb = Annotated[
    Seen | Heartbeat | Stick | TakeControl | Stop | Arm | Disarm | Goal | ClearGoals | Path
    | SwitchController | Set | Teach | Record | Note | Discover, Field(discriminator='verb')]
_ADAPTER: TypeAdapter[AnyVerb] = TypeAdapter(AnyVerb)

NAMES = tuple(get_args(kind.model_fields['verb'].annotation)[0]
              for kind in get_args(get_args(AnyVerb)[0]))
"""What pages may say, in the words of the protocol."""


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
"""What does each; STOP and the others that wait for nobody are the server's."""


async def perform(verb: Order, rig: Rig, discovery: Discovery) -> Answer:
    """Have a `verb` done by the `rig`, or by `discovery`; RefusedError with the reason if not."""
    return await _METHODS[type(verb)](verb, rig, discovery)


def told(verb: Order) -> str:
    """What a `verb` asks for, for people: what is set to what, where it is to go."""
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
            return f'Switch to {verb.name}'
        case Set():
            return f'Set {verb.name} to {verb.value}'
        case Teach():
            return f'Teach {verb.example} at {verb.x_px:.0f}, {verb.y_px:.0f} px'
        case Record():
            title = f' “{one_line(verb.title)}”' if verb.title and verb.on else ''
            return f'Record{title}' if verb.on else 'Stop recording'
        case Note():
            return f'Note “{one_line(verb.text)}”'
        case Discover():
            return f'Discover for {verb.minutes:g} min' if verb.on else 'Stop discovery'
    return type(verb).__name__.replace('Goals', ' goals')


class VerbError(ValueError):
    """What a page sent, a `text`, is no verb, for a `reason` in one sentence; `id` is its own, if
    any."""

    def __init__(self, text: str, reason: str) -> None:
        super().__init__(one_line(reason))
        self.id = _id_in(text)


def read_verb(text: str) -> AnyVerb:
    """The verb in a `text` of a page. VerbError for anything else."""
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        place = '.'.join(str(part) for part in first['loc'])
        reason = f'{place}: {first["msg"]}; received {shown(first["input"])}'
        raise VerbError(text, reason.removeprefix(': ')) from None


def _id_in(text: str) -> int | None:
    try:
        content = from_json(text)
    except ValueError:
        return None
    found = content.get('id') if isinstance(content, dict) else None
    return found if type(found) is int else None
