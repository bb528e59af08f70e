"""HOTA and IDF1 of tracks by TrackEval, beside those of trackpy and laptrack.

TrackEval, laptrack and scikit-image are extras of these figures alone, in an environment
of their own: TrackEval brings opencv-python, which overwrites the headless build.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import pandas

Shown = tuple[np.ndarray, np.ndarray]
"""Identities (N,) and places (N, 2) [px] in one frame."""

Seen = dict[int, Shown]
"""Identities and places by frame."""

NEEDED = ('trackeval', 'laptrack', 'skimage')
"""Packages without which there are no such figures."""


def available() -> bool:
    """Return whether all packages of these figures are installed."""
    return all(find_spec(name) for name in NEEDED)


def scores(truth: Sequence[Shown], found: Sequence[Shown], near: float) -> tuple[float, float]:
    """Return HOTA and IDF1 of what was `found` in frames, by the `truth` in the same frames.

    A place is as similar to a robot's as 1 − distance / (2 `near`): one half at `near` [px], at
    which IDF1 counts a place as met. HOTA is the mean over similarities from 0.05 to 0.95.
    """
    from trackeval.metrics import HOTA, Identity

    def numbered(shown: Sequence[Shown]) -> tuple[int, list[np.ndarray]]:
        known = {name: k for k, name in enumerate(sorted(
            {name for ids, _ in shown for name in ids.tolist()}))}
        return len(known), [np.array([known[name] for name in ids.tolist()], int)
                            for ids, _ in shown]

    robots, theirs = numbered(truth)
    tracks, ours = numbered(found)
    data = {
        'num_timesteps': len(truth), 'num_gt_ids': robots, 'num_tracker_ids': tracks,
        'num_gt_dets': sum(map(len, theirs)), 'num_tracker_dets': sum(map(len, ours)),
        'gt_ids': theirs, 'tracker_ids': ours,
        'similarity_scores': [
            np.maximum(0, 1 - np.linalg.norm(real[:, None] - seen, axis=2) / 2 / near)
            for (_, real), (_, seen) in zip(truth, found, strict=True)]}
    hota = HOTA().eval_sequence(data)['HOTA']
    idf1 = Identity({'PRINT_CONFIG': False}).eval_sequence(data)['IDF1']
    return float(np.mean(hota)), float(idf1)


def rivals(places: pandas.DataFrame, leasts: Iterable[float], steps: Iterable[float],
           ) -> Iterator[tuple[str, Seen]]:
    """Yield the tracks that trackpy and laptrack link, for every least mass and step.

    `places` are what `trackpy.locate` found in all frames; `steps` are px a frame.
    """
    import trackpy
    from laptrack import LapTrack

    trackpy.quiet()
    for least in leasts:
        table = places[places['mass'] >= least]
        for step in steps:
            try:
                linked = trackpy.link(table.copy(), step, memory=5)
            except trackpy.SubnetOversizeException:
                continue  # too many in reach of each other
            yield 'trackpy', _by_frame(linked, 'particle')
            lap = LapTrack(cutoff=step**2, gap_closing_cutoff=(2 * step)**2,
                           gap_closing_max_frame_count=5)
            tracks, _, _ = lap.predict_dataframe(
                table[['x', 'y', 'frame']].reset_index(drop=True), ['x', 'y'], frame_col='frame',
                only_coordinate_cols=False)
            yield 'laptrack', _by_frame(tracks.rename(columns={'frame_y': 'frame'}), 'track_id')


def _by_frame(table, identity: str) -> Seen:  # type: ignore[no-untyped-def]
    column = 'frame' if 'frame' in table.columns else None
    frames = table[column] if column else table.index.get_level_values('frame')
    frames = np.asarray(frames)
    ids, xy = table[identity].to_numpy(), table[['x', 'y']].to_numpy()
    return {int(t): (ids[frames == t], xy[frames == t]) for t in np.unique(frames)}
