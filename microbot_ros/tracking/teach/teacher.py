"""Learning kinds from points in pictures: examples and counter-examples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from microbot_ros.common.checked import SettingsError
from microbot_ros.common.errors import InputError, shown
from microbot_ros.tracking.locate.bodies import Bodies, contrast, find_bodies
from microbot_ros.tracking.locate.kinds import Kind, traits, with_examples
from microbot_ros.tracking.locate.search import pixel_noise
from microbot_ros.tracking.settings import TrackerSettings

_VIEW = 200
"""Choice: pixels around a point that are examined."""

_WIDEST = 120.0
"""Choice: widest body [px] that can be pointed at."""

_PARTS = (0.0, 4.0, 8.0, 16.0, 32.0)
"""Choice: distances [px] tried below which parts belong to one body."""

_CLEAR = 7.0
"""Choice: standard deviations of the noise by which a body must stand out."""

_SLOPPY = 8.0
"""Choice: pixels by which people miss."""

_AS_GOOD = 0.6
"""Choice: share of the contrast that a body must keep when its parts are joined."""

_LONE = 0.6
"""Choice: share of a body's weight around it from which it counts as a part."""

_FEWER = 0.7
"""Choice: share of the surroundings that joined parts must leave, or they are other bodies."""

_ACROSS, _PLAIN = 7.5, 0.9
"""Choices: shrunk pixels across a usual body, and the fill from which a body is plain.

The short axis counts for a plain body; a ragged one would fall into its parts.
"""


@dataclass(frozen=True)
class _Meant:
    """What was pointed at: a kind to search for such things, and the body (1,) itself."""

    look: Kind
    body: Bodies


class NothingError(InputError):
    """A point at (`x`, `y`) [px] where nothing stands out; `what` was to be learned.

    Parameters
    ----------
    what : str
        Name of the object that was to be learned.
    x : float
        Column [px].
    y : float
        Row [px].
    """

    def __init__(self, what: str, x: float, y: float) -> None:
        super().__init__(what, f'expected something at {x:g},{y:g}: nothing is visible there')


class TwoError(InputError):
    """A point at (`x`, `y`) [px] between `two` bodies (2,); `what` was to be learned.

    Parameters
    ----------
    what : str
        Name of the object that was to be learned.
    x : float
        Column [px].
    y : float
        Row [px].
    two : Bodies
        The two bodies.
    """

    def __init__(self, what: str, x: float, y: float, two: Bodies) -> None:
        super().__init__(what, f'expected one thing at {x:g},{y:g}: two are equally near')
        self.two = two


def like(
    settings: TrackerSettings, image: np.ndarray, x: float, y: float, name: str | None = None
) -> tuple[TrackerSettings, str]:
    """Return the `settings` with the body at (`x`, `y`) [px] of an `image` (H, W) as an example.

    A sentence about it is returned too. It is of the kind `name`; without a name of the only kind,
    or of `robot`. A point between two bodies that nearly touch means both, as one body. Raises
    InputError if nothing is there, two bodies are, it is a counter-example, or the name is
    invalid.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    image : ndarray, shape (H, W)
        The picture.
    x : float
        Column [px].
    y : float
        Row [px].
    name : str or None
        Name of the kind; None for the default.

    Returns
    -------
    tuple[TrackerSettings, str]
        The settings and the sentence.
    """
    name = name or (settings.kinds[0].name if len(settings.kinds) == 1 else 'robot')
    known = next((kind for kind in settings.kinds if kind.name == name), None)
    meant = _meant('like', image, x, y, known)
    if known is None:
        known = _named(meant.look, name)
    learned = _learn(known, image, [*known.like, *_traits(meant.body)], known.unlike)
    where = (f'{meant.body.width[0]:.0f} px wide, '
             f'{meant.body.height[0]:.0f} grey levels {_word(learned)}')
    if learned.parts_px:
        where += f', parts nearer than {learned.parts_px:g} px taken as one'
    count = len(learned.like)
    return _with(settings, learned), (
        f'{name}: learned from {count} example{"s" if count > 1 else ""}; this one is {where}')


def _named(look: Kind, name: str) -> Kind:
    """Return a kind like `look` with this `name`; InputError for an invalid name."""
    try:
        return Kind.from_content({**look.content(), 'name': name})
    except SettingsError:
        raise InputError('like', 'expected a name of at most 32 letters, digits, - and _ that '
                                 f'begins with a letter; received {shown(name)}') from None


def unlike(
    settings: TrackerSettings, image: np.ndarray, x: float, y: float, name: str | None = None
) -> tuple[TrackerSettings, str]:
    """Return `settings` without bodies like that at (`x`, `y`) [px] of an `image`, and a sentence.

    It is a counter-example of the kind `name`; without a name, of every kind that took it for its
    own. Raises InputError if no kind is known, nothing is there, or it cannot be told from the
    examples.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    image : ndarray, shape (H, W)
        The picture.
    x : float
        Column [px].
    y : float
        Row [px].
    name : str or None
        Name of the kind; None for the default.

    Returns
    -------
    tuple[TrackerSettings, str]
        The settings and the sentence.
    """
    if name is not None and name not in {kind.name for kind in settings.kinds}:
        raise InputError('unlike', f'expected a known kind; received {name}')
    if not settings.kinds:
        raise InputError('unlike', 'expected an example first (like): nothing is known yet')
    changed, said = settings, list[str]()
    unseen: list[InputError] = []
    for kind in settings.kinds:
        if name not in (None, kind.name):
            continue
        if not kind.like:
            raise InputError('unlike', f'expected an example of {kind.name} first (like)')
        try:
            meant = _meant('unlike', image, x, y, kind)
        except (NothingError, TwoError) as error:
            if name is not None:
                raise
            unseen.append(error)
            continue
        if not kind.members(meant.body, np.zeros(1, bool)).any() and name is None:
            continue
        learned = _learn(kind, image, kind.like, [*kind.unlike, *_traits(meant.body)])
        changed = _with(changed, learned)
        said.append(f'{kind.name}: not bodies {meant.body.width[0]:.0f} px wide and '
                    f'{meant.body.height[0]:.0f} grey levels {_word(kind)}')
    if len(unseen) == len(settings.kinds):
        raise unseen[-1]
    return changed, '; '.join(said) or 'it was not detected as any kind before: nothing to change'


def forget(settings: TrackerSettings, name: str | None = None) -> tuple[TrackerSettings, str]:
    """Return the `settings` without the kind `name`, or without any, and a sentence.

    Parameters
    ----------
    settings : TrackerSettings
        Settings of the tracker.
    name : str or None
        Name of the kind; None for all.

    Returns
    -------
    tuple[TrackerSettings, str]
        The settings and the sentence.
    """
    if name is not None and name not in {kind.name for kind in settings.kinds}:
        raise InputError('forget', f'expected a known kind; received {name}')
    if not settings.kinds:
        raise InputError('forget', 'expected a taught kind: none is known')
    left = tuple(kind for kind in settings.kinds if name is not None and kind.name != name)
    places = settings.standing if left else ()
    return (settings.replaced(kinds=left, standing=places),
            f'{name or "all"}: forgotten')


def _with(settings: TrackerSettings, learned: Kind) -> TrackerSettings:
    names = [kind.name for kind in settings.kinds]
    kinds = list(settings.kinds)
    if learned.name in names:
        kinds[names.index(learned.name)] = learned
    else:
        kinds.append(learned)
    return settings.replaced(kinds=tuple(kinds))


def _word(kind: Kind) -> str:
    return 'darker' if kind.dark else 'brighter'


def _traits(body: Bodies) -> list[tuple[float, ...]]:
    return [tuple(row) for row in traits(body).tolist()]


def _learn(kind: Kind, image: np.ndarray, examples: Sequence, counter: Sequence) -> Kind:
    picture = contrast(image, kind.shrink, 3 * float(examples[0][1]), kind.dark)
    clutter = -float(np.quantile(picture[::2, ::2], 0.01))
    return with_examples(kind, examples, counter, max(clutter, 0.0))


def _meant(what: str, image: np.ndarray, x: float, y: float, known: Kind | None) -> _Meant:
    """Return what a person means by pointing at (x, y), searched as a known kind, or as any."""
    height, width = image.shape
    if not (-0.5 <= x < width - 0.5 and -0.5 <= y < height - 0.5):
        raise InputError(what, f'expected a point in the image of {width}×{height} pixels; '
                               f'received {x:g},{y:g}')
    if known is None:
        known = _way_to_look(what, image, x, y)
    bodies = _looked_at(image, known)
    return _Meant(known, bodies[np.array([_pointed(what, bodies, x, y)])])


def _looked_at(image: np.ndarray, kind: Kind) -> Bodies:
    """Return all bodies of a picture, searched as a kind is, whatever their traits."""
    widest = 3 * kind.typical_width_px
    least = min(0.4 * kind.height_grey[0], _CLEAR * pixel_noise(image))
    return find_bodies(image, kind.dark, least, kind.shrink, widest, kind.parts_px)


def _pointed(what: str, bodies: Bodies, x: float, y: float) -> int:
    """Return the body at a point; InputError if there is none, or it may be either of two."""
    if len(bodies) == 0:
        raise NothingError(what, x, y)
    within = np.all((bodies.lower - 1 <= [x, y]) & ([x, y] <= bodies.upper + 1), axis=1)
    away = np.hypot(bodies.xy[:, 0] - x, bodies.xy[:, 1] - y)
    near = np.flatnonzero(within | (away < bodies.width / 2 + _SLOPPY))
    # Ignore specks of noise beside a body.
    near = near[bodies.height[near] > 0.3 * np.max(bodies.height[near], initial=0.0)]
    if len(near) == 0:
        raise NothingError(what, x, y)
    order = near[np.argsort(away[near])]
    first = order[0]
    if len(order) > 1 and away[first] > bodies.width[first] / 2:
        second = order[1]
        if away[second] < 1.5 * away[first] + 1:
            raise TwoError(what, x, y, bodies[order[:2]])
    return int(first)


def _way_to_look(what: str, image: np.ndarray, x: float, y: float) -> Kind:
    """Return how to search for the body at (x, y): sign, resolution and parts."""
    left, top = max(int(x) - _VIEW, 0), max(int(y) - _VIEW, 0)
    view = np.ascontiguousarray(image[top:int(y) + _VIEW, left:int(x) + _VIEW])
    ways: list[tuple[float, bool, Bodies]] = []
    problem: InputError | None = None
    for dark in (True, False):
        try:
            ways.append(_by_parts(what, view, x - left, y - top, dark))
        except InputError as error:
            problem = problem or error
    if not ways:
        assert problem is not None
        if isinstance(problem, TwoError):
            raise TwoError(what, x, y, problem.two)
        raise NothingError(what, x, y)
    # The stronger body is meant, unless the point is beside it.
    off = [np.hypot(body.xy[0, 0] - x + left, body.xy[0, 1] - y + top) / body.width[0]
           for _, _, body in ways]
    best = int(np.argmax([body.height[0] / (1 + 4 * away**2)
                          for (_, _, body), away in zip(ways, off, strict=True)]))
    parts, dark, body = ways[best]
    width = float(body.width[0])
    plain = body.fill[0] > _PLAIN
    across = width / float(np.sqrt(body.length[0])) if plain else width
    return Kind(contrast='dark' if dark else 'bright', parts_px=parts,
                shrink=int(np.clip(across / _ACROSS, 1, 8)),
                height_grey=(float(body.height[0]), 1e6), width_px=(width, width))


def _by_parts(
    what: str, view: np.ndarray, x: float, y: float, dark: bool
) -> tuple[float, bool, Bodies]:
    """Return the body at a point, and the part distance that leaves little around it.

    The distance is the least possible. For a point between two bodies: the least distance that
    makes them one, up to their width.
    """
    best: tuple[float, float, Bodies] | None = None
    problem: InputError | None = None
    two: Bodies | None = None
    whole: tuple[float, bool, Bodies] | None = None
    least = _CLEAR * pixel_noise(view)
    first = 0.0
    for parts in _PARTS:
        shrink = max(1, int(parts / 4))
        bodies = find_bodies(view, dark, least / shrink, shrink, _WIDEST, parts)
        try:
            k = _pointed(what, bodies, x, y)
        except InputError as error:
            problem = problem or error
            if two is None and isinstance(error, TwoError):
                two = error.two
            if first == 0 and len(bodies):
                first = float(bodies.height[np.argmin(np.hypot(*(bodies.xy - [x, y]).T))])
            continue
        if two is not None and parts <= two.width.min() and _holds(bodies, k, two):
            whole = whole or (parts, dark, bodies[np.array([k])])
        first = first or float(bodies.height[k])
        around = _around(bodies, k)
        if bodies.height[k] < _AS_GOOD * first:
            break
        if best is None or around < _FEWER * best[0]:
            best = around, parts, bodies[np.array([k])]
        if best[0] < _LONE:
            break
    if best is not None:
        return best[1], dark, best[2]
    if whole is None:
        raise problem or NothingError(what, x, y)
    return whole


def _holds(bodies: Bodies, k: int, others: Bodies) -> bool:
    """Return whether the box around body `k` contains the centroids of all the `others`."""
    return bool(np.all((bodies.lower[k] <= others.xy) & (others.xy <= bodies.upper[k])))


def _around(bodies: Bodies, k: int) -> float:
    """Return the weight (height × area) within a width of a body, over its own."""
    weight = bodies.height * bodies.width**2
    reach = bodies.width[k]
    near = np.all((bodies.xy > bodies.lower[k] - reach) & (bodies.xy < bodies.upper[k] + reach),
                  axis=1)
    near[k] = False
    return float(weight[near].sum() / weight[k])
