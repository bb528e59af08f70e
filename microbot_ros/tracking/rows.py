"""Streaming output of `tracks.csv` rows and of remarks about frames."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from typing import TextIO

import numpy as np

from microbot_ros.common.units import from_si
from microbot_ros.tracking.camera import ImageToWorkspace
from microbot_ros.tracking.link.doubt import together
from microbot_ros.tracking.tracker import Poses


class Rows:
    """Writes rows to a `file` frame by frame, delayed as long as a particle may still be named.

    With a pixel size, rows also have times, and positions, headings and σ in the workspace; with
    `kinds` they end with the name of the kind. Unknown values are empty: a heading, and heading
    and σ of particles that had no name yet. `frames` counts tracked frames, `seen` the rows of
    each particle. `size` (height, width) of the frames [px]; `pixel_size` [m] or None.

    Parameters
    ----------
    file : TextIO
        The file.
    size : tuple[int, int]
        Height and width of the pictures [px].
    pixel_size : float or None
        Size of a pixel [m]; None for unknown.
    kinds : sequence of str
        Names of the kinds; empty for no kinds.
    """

    def __init__(self, file: TextIO, size: tuple[int, int], pixel_size: float | None,
                 kinds: Sequence[str] = ()) -> None:
        self.frames = 0
        self.seen: Counter[int] = Counter()
        self._file = file
        height, width = size
        self._in_metres = pixel_size is not None
        self._camera = ImageToWorkspace(pixel_size or 1.0, width, height)
        self._names = kinds
        self._kinds: dict[int, int] = {}
        self._open: deque[tuple[int, float, list[tuple[int, np.ndarray]]]] = deque()
        file.write('frame,particle,x_px,y_px'
                   + (',t_s,x_um,y_um,theta_rad,sigma_um' if self._in_metres else '')
                   + (',kind\n' if kinds else '\n'))

    def add(self, frame: int, poses: Poses, names: np.ndarray, before: np.ndarray) -> None:
        """Add the `poses` of a `frame` and the `names` (n,) of particles named in it.

        Those were at `before` (n, K, 2) [px] in the K frames before.

        Parameters
        ----------
        frame : int
            Number of the frame.
        poses : Poses
            Poses of the particles.
        names : ndarray, shape (n,)
            Identities of particles named in the frame.
        before : ndarray, shape (n, K, 2)
            Their positions in the K frames before [px].
        """
        self.frames += 1
        self._kinds.update(zip(poses.id.tolist(), poses.kind.tolist(), strict=True))
        known = np.column_stack([
            poses.xy, poses.sigma_px, self._camera.angle(poses.theta_rad + np.pi)])
        self._open.append((frame, poses.t, list(zip(
            poses.id[poses.seen].tolist(), known[poses.seen], strict=True))))
        early = before.shape[1]
        unknown = np.full((len(names), 2), np.nan)
        for k in range(early if len(names) else 0):
            self._open[k - early - 1][2].extend(zip(
                names.tolist(), np.column_stack([before[:, k], unknown]), strict=True))
        while len(self._open) > early + 1:
            self._write(*self._open.popleft())

    def close(self) -> None:
        """Write all remaining rows; the file stays open."""
        while self._open:
            self._write(*self._open.popleft())

    def _write(self, frame: int, t: float, rows: list[tuple[int, np.ndarray]]) -> None:
        for name, (x, y, sigma, theta) in sorted(rows, key=lambda row: row[0]):
            cells = [f'{frame},{name},{x:.4f},{y:.4f}']
            if self._in_metres:
                x, y = from_si('_um', self._camera.position(np.array([x, y])))
                sigma *= from_si('_um', self._camera.pixel_size)
                cells += [f'{t:.6f},{x:.5f},{y:.5f}', _known(theta, 4), _known(sigma, 5)]
            if self._names:
                cells.append(self._names[self._kinds[name]])
            self._file.write(','.join(cells) + '\n')
            self.seen[name] += 1


def _known(value: float, digits: int) -> str:
    return '' if np.isnan(value) else f'{value:.{digits}f}'


class Remarks:
    """Problems of the frames: the first sentence of each kind, and their number."""

    def __init__(self) -> None:
        self._first: dict[str, tuple[int, str]] = {}
        self._count: Counter[str] = Counter()

    def add(self, frame: int, said: Mapping[str, str]) -> None:
        """Add the sentences `said` about a `frame`: kind → sentence.

        Parameters
        ----------
        frame : int
            Number of the frame.
        said : mapping of str to str
            Sentence by kind.
        """
        for kind, sentence in said.items():
            self._first.setdefault(kind, (frame, sentence))
            self._count[kind] += 1

    def sentences(self) -> list[str]:
        """Return one sentence per kind, and one for all particles of which the same is said.

        Returns
        -------
        list of str
            The sentences.
        """
        first, counts = list(self._first.values()), [self._count[kind] for kind in self._first]
        told = []
        for sentence, places in together(sentence for _, sentence in first).items():
            most = max(counts[place] for place in places)
            told.append(f'frame {first[places[0]][0]}: {sentence}'
                        + (f'; {most} frames like it' if most > 1 else ''))
        return told
