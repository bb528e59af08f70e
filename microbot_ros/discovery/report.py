"""`report.html`: what was found, for people. One file, pictures inside."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import jinja2
import numpy as np

from microbot_ros import __version__
from microbot_ros.discovery.report_figures import draw_bands, draw_gap, draw_maps, embedded
from microbot_ros.discovery.report_prediction import predict
from microbot_ros.discovery.result import Discovery, Estimate, Limit, NamedEffect
from microbot_ros.files import write_text
from microbot_ros.model.effects import EFFECTS
from microbot_ros.records import Session
from microbot_ros.units import from_si, suffix, symbol

_TEMPLATE = Path(__file__).with_name('report.html')
_HASHED = {'.csv', '.yaml', '.mcap', '.db3', '.json'}

_SPEED = {'catalytic': 'v_um_s', 'rolling': 'gain_um_s_hz'}


def write_report(folder: Path, found: Discovery, sessions: Sequence[Session],
                 sources: Sequence[Path]) -> None:
    """Write `report.html` into a folder.

    `sessions` are those that `found` came from, in the same order, read from `sources`.
    """
    write_text(Path(folder) / 'report.html', page(found, sessions, sources))


def page(found: Discovery, sessions: Sequence[Session], sources: Sequence[Path]) -> str:
    """The report as HTML that needs nothing else; the same data give the same page."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {'number': number, 'chance': chance, 'words': words, 'limit': limit}
    environment.globals |= {'interval': interval}
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    prediction = predict(found, sessions[-1])
    maps = draw_maps(found.maps_before, found.maps_after)
    return template.render(
        found=found, headline=headline(found), library=EFFECTS, sessions=sessions,
        speed=_SPEED[found.model.propulsion], prediction=prediction,
        gap_figure=embedded(draw_gap(found.gap)), maps_figure=maps and embedded(maps),
        band_figure=embedded(draw_bands(prediction)),
        hashes=[line for source in sources for line in digests(Path(source))],
        versions={'microbot_ros': __version__} | {
            package: version(package) for package in ('numpy', 'scipy', 'numba')})


def headline(found: Discovery) -> str:
    """The verdict in one sentence, with the number, its interval and the evidence."""
    established = [e for e in found.effects if e.status == 'established']
    if found.verdict == 'named':
        return 'Missing from the first-order model: ' + '; '.join(map(_told, established)) + '.'
    if found.verdict == 'unnamed':
        against = '; '.join(f'{m.against} ({chance(m.p_value)})' for m in found.unexplained[:3])
        more = len(found.unexplained) - 3
        against += f'; and {more} more' if more > 0 else ''
        near = ' and '.join(words(e.id) for e in found.effects)
        rest = f' The nearest that it has, {near}, can only stand in.' if near else ''
        return ('Something is there that no effect of the library explains. It shows against '
                f'{against}.{rest}')
    hint = ', '.join(words(e.id) for e in found.effects)
    return ('Nothing is missing: the first-order model explains these data down to the noise.'
            + (f' There is a hint of {hint}, too weak to be established.' if hint else ''))


def _told(effect: NamedEffect) -> str:
    values = ', '.join(
        f'{_bare(name)} = {interval(name, e)}' for name, e in effect.parameters.items())
    return (f'{words(effect.id)}, {values} (95 % interval; ΔBIC {effect.delta_bic:.0f}, '
            f'{chance(effect.p_value)})')


def _bare(name: str) -> str:
    return name.removesuffix(suffix(name)).replace('_', ' ')


def interval(name: str, estimate: Estimate) -> str:
    """A value with its 95 % interval in the unit of its name: `0.41 ± 0.06 µm/s`."""
    value, half = (float(from_si(name, x)) for x in (estimate.value, 1.96 * estimate.std))
    if not np.isfinite(value):
        return '–'
    if not (np.isfinite(half) and half > 0):
        return f'{value:.3g} {symbol(name)}'.strip()
    digits = max(0, 1 - int(np.floor(np.log10(half))))
    if digits > 6:
        sign = '−' if value < 0 else ''
        return f'{sign}{number(abs(value))} ± {number(half)} {symbol(name)}'.strip()
    return f'{value:.{digits}f} ± {half:.{digits}f} {symbol(name)}'.strip().replace('-', '−')


def chance(p: float) -> str:
    """A p-value as people write it: `p = 0.03`, `p < 10⁻³⁰⁰` where it can't be computed."""
    return f'p = {number(p)}' if p > 0 else 'p < 10⁻³⁰⁰'


def number(x: float) -> str:
    """0.03 as it is, 4·10⁻⁹ with its power."""
    if not np.isfinite(x):
        return 'beyond computing' if x > 0 else '–'
    if x == 0 or 0.001 <= x < 1e5:
        return f'{x:.2g}' if x < 100 else f'{x:.0f}'
    digits, exponent = f'{x:.0e}'.split('e')
    raised = str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))
    return f'{digits}·10{raised}'


def words(identifier: str) -> str:
    """`uniform_drift` as people write it."""
    return identifier.replace('_', ' ')


def limit(found: Limit) -> str:
    """Where a parameter may still be: `up to 0.1 µm/s`, `1 ± 0.02`, `900 s or longer`."""
    parameter, unit = found.parameter, symbol(found.parameter.name)
    if not np.isfinite(found.upper_limit):
        return 'not bounded by these data'
    neutral = float(parameter.edge(parameter.neutral))
    value = float(parameter.edge(found.upper_limit))
    if parameter.inverse:
        return f'{value:.3g} {unit} or longer'
    if neutral:
        return f'within {neutral:g} ± {abs(value - neutral):.2g} {unit}'.strip()
    return f'up to {abs(value):.2g} {unit}'.strip()


def digests(source: Path) -> list[tuple[str, str]]:
    """(file, SHA-256) of the data files of a session, as `sha256sum` prints them."""
    files = sorted(source.iterdir()) if source.is_dir() else [source]
    result = []
    for file in files:
        if file.suffix in _HASHED and file.is_file():
            with file.open('rb') as stream:
                digest = hashlib.file_digest(stream, 'sha256').hexdigest()
            result.append((f'{source.name}/{file.name}' if source.is_dir() else file.name, digest))
    return result
