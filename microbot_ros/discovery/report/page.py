"""`report.html`: the result for people, in one file with its figures."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import jinja2
import markupsafe

from microbot_ros.common.files import write_text
from microbot_ros.common.records import Session
from microbot_ros.common.units import symbol
from microbot_ros.discovery.report import words as report_words
from microbot_ros.discovery.report.drive import draw_drive, drive
from microbot_ros.discovery.report.figures import (
    AFTER,
    BEFORE,
    draw_bands,
    draw_gap,
    draw_maps,
    draw_places,
    embedded,
)
from microbot_ros.discovery.report.learned import draw_learned
from microbot_ros.discovery.report.prediction import predict
from microbot_ros.discovery.report.residual import residual
from microbot_ros.discovery.report.summary import summary
from microbot_ros.discovery.report.words import bare, chance, interval, listed, number
from microbot_ros.discovery.result import FIRES, Discovery, NamedEffect
from microbot_ros.discovery.verdict import enough
from microbot_ros.model.effects import EFFECTS

_TEMPLATE = Path(__file__).with_name('report.html')
"""Template of the report."""

_HASHED = {'.csv', '.yaml', '.mcap', '.db3', '.json'}
"""Suffixes of data files whose SHA-256 the report lists."""

_SPEED = {'catalytic': 'v_um_s', 'rolling': 'gain_um_s_hz'}
"""Propulsion → name, with unit, of a particle's speed."""


def write_report(folder: Path, found: Discovery, sessions: Sequence[Session],
                 sources: Sequence[Path], asked: str = '', used: str = '') -> None:
    """Write `report.html` into a folder.

    Parameters
    ----------
    folder : Path
        Folder of the report.
    found : Discovery
        Result of the search.
    sessions : sequence of Session
        Sessions of the result, in the same order.
    sources : sequence of Path
        Files or folders that the sessions were read from.
    asked : str, optional
        HTML on how the sessions were chosen, where discovery drove the rig.
    used : str, optional
        HTML on the result of using the model.
    """
    write_text(Path(folder) / 'report.html', page(found, sessions, sources, asked, used))


def page(found: Discovery, sessions: Sequence[Session], sources: Sequence[Path],
         asked: str = '', used: str = '') -> str:
    """Return the report as HTML that needs no other file.

    The same data give the same page.

    Parameters
    ----------
    found : Discovery
        Result of the search.
    sessions : sequence of Session
        Sessions of the result, in the same order.
    sources : sequence of Path
        Files or folders that the sessions were read from.
    asked : str, optional
        HTML on how the sessions were chosen, where discovery drove the rig.
    used : str, optional
        HTML on the result of using the model.

    Returns
    -------
    str
        The page.
    """
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    environment.filters |= {
        name: getattr(report_words, name)
        for name in ('bare', 'chance', 'limit', 'number', 'odds', 'term', 'words')}
    environment.filters['unit'] = symbol
    environment.globals |= {'interval': interval}
    template = environment.from_string(_TEMPLATE.read_text(encoding='utf-8'))
    left = residual(found, sessions[-1])
    prediction = predict(found, left)
    maps = draw_maps(found.maps_before, found.maps_after)
    places = draw_places(left, found.diffusion.value)
    driven = drive(left, found.particles.phi, found.diffusion.value)
    return template.render(
        found=found, summary=summary(found), headline=headline(found), library=EFFECTS,
        sessions=sessions, fires=FIRES,
        speed=_SPEED[found.model.propulsion], prediction=prediction,
        learned=[(one, embedded(draw_learned(one.term))) for one in found.learned],
        gap_figure=embedded(draw_gap(found.gap)), maps_figure=maps and embedded(maps),
        places_figure=places and embedded(places), band_figure=embedded(draw_bands(prediction)),
        drive_figure=driven and embedded(draw_drive(driven, BEFORE, AFTER)),
        hashes=[line for source in sources for line in digests(Path(source))],
        versions=report_words.versions(), enough=enough(), asked=markupsafe.Markup(asked),
        used=markupsafe.Markup(used))


def headline(found: Discovery) -> str:
    """Return the verdict in a sentence or two: number, interval and evidence.

    Parameters
    ----------
    found : Discovery
        Result of the search.

    Returns
    -------
    str
        Plain text.
    """
    sure = [e for e in found.effects if e.status == 'established']
    rest = [e.id for e in found.effects if e.status != 'established']
    told = '; '.join(map(_told, sure))
    if found.verdict == 'named':
        return (f'Missing from the first-order model: {told}.'
                + (f' The residuals are small compared with it, and depend on {_against(found)}.'
                   if found.unexplained else ''))
    if found.verdict == 'consistent':
        return ('No effect was found: the first-order model explains these data down to the noise.'
                + (f' There is a hint of {listed(rest)}, too weak to be established.'
                   if rest else '')
                + (' The residuals do not improve the prediction; they depend on '
                   f'{_against(found)}.'
                   if found.unexplained else ''))
    learned = dict.fromkeys(one.sentence() for one in found.learned)
    return (f'The data show an effect that is not in the library. It depends on {_against(found)}.'
            + (f' Of what the library has, {listed(rest)} can only stand in for it.'
               if rest else '')
            + (f' Established as well: {told}.' if sure else '')
            + ''.join(f' {sentence}' for sentence in learned))


def _against(found: Discovery) -> str:
    """Return the three covariates of the smallest p-value."""
    shown = '; '.join(f'{m.against} ({chance(m.p_value)})' for m in found.unexplained[:3])
    more = len(found.unexplained) - 3
    return f'{shown}; and {more} more' if more > 0 else shown


def _told(effect: NamedEffect) -> str:
    values = ', '.join(
        f'{bare(name)} = {interval(name, e)}' for name, e in effect.parameters.items())
    return (f'{report_words.words(effect.id)}, {values} (95 % intervals; '
            f'ΔBIC {number(effect.delta_bic)}, {chance(effect.p_value)})')


def digests(source: Path) -> list[tuple[str, str]]:
    """Return the checksums of the data files of a session, as `sha256sum` prints them.

    Parameters
    ----------
    source : Path
        File or folder of the session.

    Returns
    -------
    list of (str, str)
        File and SHA-256.
    """
    files = sorted(source.iterdir()) if source.is_dir() else [source]
    result = []
    for file in files:
        if file.suffix in _HASHED and file.is_file():
            with file.open('rb') as stream:
                digest = hashlib.file_digest(stream, 'sha256').hexdigest()
            result.append((f'{source.name}/{file.name}' if source.is_dir() else file.name, digest))
    return result
