"""HOTA and IDF1 of tracks by TrackEval, beside those of trackpy and laptrack.

TrackEval, laptrack and scikit-image are extras of these figures alone, in an environment
of their own: TrackEval brings opencv-python, which overwrites the headless build.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec

import numpy as np

Seen = dict[int, tuple[np.ndarray, np.ndarray]]
"""Identities (N,) and places (N, 2) [px] by frame."""

NEEDED = ('trackeval', 'laptrack', 'skimage')
"""Packages without which there are no such figures."""


def available() -> bool:
    """Return whether all packages of these figures are installed."""
    return all(find_spec(name) for name in NEEDED)


def scores(truth: np.ndarray, seen: Seen, near: float) -> tuple[float, float]:
    """Return HOTA and IDF1 of what was `seen` of robots at `truth` (T, N, 2) [px].

    A place is as similar to a robot's as 1 − distance / (2 `near`): one half at `near` [px], at
    which IDF1 counts a place as met. HOTA is the mean over similarities from 0.05 to 0.95.
    """
    from trackeval.metrics import HOTA, Identity

    known = {name: k for k, name in enumerate(sorted(
        {int(name) for ids, _ in seen.values() for name in ids}))}
    frames = range(len(truth))
    none = np.empty(0, int), np.empty((0, 2))
    found = [seen.get(t, none) for t in frames]
    data = {
        'num_timesteps': len(truth), 'num_gt_ids': truth.shape[1], 'num_tracker_ids': len(known),
        'num_gt_dets': truth.shape[0] * truth.shape[1],
        'num_tracker_dets': sum(len(ids) for ids, _ in found),
        'gt_ids': [np.arange(truth.shape[1]) for _ in frames],
        'tracker_ids': [np.array([known[int(name)] for name in ids], int) for ids, _ in found],
        'similarity_scores': [
            np.maximum(0, 1 - np.linalg.norm(truth[t][:, None] - found[t][1], axis=2) / 2 / near)
            for t in frames]}
    hota = HOTA().eval_sequence(data)['HOTA']
    idf1 = Identity({'PRINT_CONFIG': False}).eval_sequence(data)['IDF1']
    return float(np.mean(hota)), float(idf1)


def rivals(frames: list[np.ndarray], diameter: int, step: float
           ) -> Iterator[tuple[str, Seen]]:
    """Yield what trackpy and laptrack see in `frames` of dark robots, for every least mass tried.

    Both link what `trackpy.locate` finds with the `diameter` [px], over `step` [px] a frame.
    """
    import trackpy
    from laptrack import LapTrack

    trackpy.quiet()
    places = trackpy.batch(frames, diameter, invert=True, engine='python', processes=1)
    for share in (0.95, 0.98, 0.99, 0.995):
        table = places[places['mass'] >= places['mass'].quantile(share)]
        yield 'trackpy', _by_frame(trackpy.link(table.copy(), step, memory=5), 'particle')
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
