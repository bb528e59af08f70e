"""Look for a correction with ADCD; runs in the environment of `make foreign`.

`python adcd_corrections.py GIVEN.npz TOLD.npz`: GIVEN has `design` (n, M), inputs of a `target`
(n,), their `names` (M), and inputs `every` (m, M). Each input is tried as the only one, with a
correction that vanishes towards 0 and towards infinity, on the means of POINTS groups of rows with
neighbouring inputs; BIC, of all rows, takes one of them, or none. TOLD has `values` (m,) of its
formula for `every`, how many `constants` it has, and its `text`.
"""

from __future__ import annotations

import sys

import adcd
import numpy as np
import sympy

POINTS = 200
"""Points of a fit: as many as ADCD's own benchmarks have."""


def main() -> None:
    """Write the correction that the best BIC has."""
    with np.load(sys.argv[1]) as given:
        design, target, every, names = (
            given[key] for key in ('design', 'target', 'every', 'names'))
    count = len(target)
    best = (count * np.log(np.mean(target**2)), np.zeros(len(every)), 0, '0')
    for column, name in enumerate(names.tolist()):
        rows = np.array_split(np.argsort(design[:, column], kind='stable'), POINTS)
        points, means = (np.array([part[one].mean() for one in rows])
                         for part in (design[:, column], target))
        for limit in ('0', 'oo'):
            found = adcd.fit({name: points}, means, np.zeros(POINTS), name, limit,
                             correction_mode='additive', verbose=False, scenario_name=name)
            if not found.best_expr:
                continue
            numbers = found.best_theta
            law = sympy.sympify(found.best_expr).subs(numbers)
            call = sympy.lambdify(sympy.Symbol(name), law, 'numpy')
            with np.errstate(all='ignore'):
                error = np.mean((target - _real(call, design[:, column])) ** 2)
                bic = count * np.log(error) + len(numbers) * np.log(count)
                if bic < best[0]:
                    best = (bic, _real(call, every[:, column]), len(numbers), str(law))
    _, values, constants, text = best
    np.savez(sys.argv[2], values=values, constants=constants, text=text)


def _real(call: object, at: np.ndarray) -> np.ndarray:
    """Values of a formula; NaN where they are not real numbers."""
    values = np.broadcast_to(call(at.astype(complex)), at.shape)  # type: ignore[operator]
    return np.where(np.abs(values.imag) < 1e-9, values.real, np.nan)


if __name__ == '__main__':
    main()
