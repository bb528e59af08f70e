"""From what is left to a term: which covariate and frame, which curve, which formula, how sure."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from microbot_ros.discovery.learned.candidates import candidates
from microbot_ros.discovery.learned.curve import Curve, Kernel, curve_of, kernels
from microbot_ros.discovery.learned.grammar import FittedFormula, grammar
from microbot_ros.discovery.learned.grammar import fit as refit
from microbot_ros.discovery.learned.moments import FOLDS, Moments
from microbot_ros.estimation.likelihood.model_fit import ModelFit, evaluate, fit_noise
from microbot_ros.model.learned_term import LearnedTerm

CONVINCING = float(np.log(1000))
"""Log evidence that a term must have, once all that were looked at are paid for."""

HELD_OUT = float(np.log(20))
"""Gain in log likelihood that a curve must bring to rows that it was not learned from; log n more
for the n-th candidate that is tried."""

POSSIBLE = 1e-3
"""Odds of a pair of covariate and frame from which it is tried in a fold of rows: a choice."""

Pair = tuple[str, str, str]
"""Covariate, frame and what a term acts on."""

MOST = 3
"""Terms that are learned, at most."""

CHANCE = 0.05
"""p in PASTIS' price k ln(n₀/p) for the k numbers of one of n₀ formulas."""

DECISIVE = 5.0
"""Log evidence by which a curve rules a formula out (Kass and Raftery 1995: very strong)."""

MOST_SURE = 0.8
"""Share of a formula, at most, in what may be true: the grammar is small."""

DRAWN = 120
"""Tables from which a band is made."""


@dataclass(frozen=True)
class Finding:
    """A `term` that was learned beside a `fit`: `curve` from its `moments`, and its odds.

    `odds` {(against, frame, acts on): share} of all candidates, the likeliest first;
    `log_evidence` over nothing at all, all candidates paid for; `formula` where one does better.
    """

    term: LearnedTerm
    moments: Moments
    curve: Curve
    formula: FittedFormula | None
    log_evidence: float
    odds: dict[Pair, float]

    @property
    def gain(self) -> float:
        """Log likelihood of the data with the term over that without, as far as rows tell."""
        gram, projection = self.moments.total
        values = self.curve.mean
        return float(projection @ values - 0.5 * values @ gram @ values)


def learn_terms(fit: ModelFit, first: Finding | None,
                report: Callable[[str], None] = lambda _: None) -> tuple[Finding, ...]:
    """The terms that explain what a `fit` leaves, one after the other; none if nothing convinces.

    `first` is the one of `learn_term`. Each is learned beside those before it, which are then
    learned again beside each other. `report` is told what is being done.
    """
    return tuple(map(finish, _curves(fit, first, report)))


def _curves(fit: ModelFit, first: Finding | None,
            report: Callable[[str], None] = lambda _: None,
            pairs: Collection[Pair] | None = None) -> list[Finding]:
    """Return the terms of `learn_terms` as curves without a band."""
    findings: list[Finding] = []
    found = first
    while found is not None and len(findings) < MOST:
        findings.append(found)
        if len(findings) > 1:
            findings = again_beside_each_other(fit, findings)
        if len(findings) < MOST:
            found = learn_term(with_terms(fit, findings), report, pairs)
    return findings


def again_beside_each_other(fit: ModelFit, findings: Sequence[Finding]) -> list[Finding]:
    """The `findings`, each learned again from what a `fit` with all others leaves."""
    learned = list(findings)
    for k in range(len(learned)):
        others = [one for i, one in enumerate(learned) if i != k]
        moments, curve = _moments_of(with_terms(fit, others), learned[k].moments.term)
        learned[k] = replace(learned[k], moments=moments, curve=curve,
                             term=_filled(moments, curve.mean))
    return learned


def _moments_of(fit: ModelFit, table: LearnedTerm) -> tuple[Moments, Curve]:
    """What the sessions of a `fit` say of a `table`, at the noise that is left with it."""
    known = told(fit)
    first = Moments.of(known, table, _noise(known))
    known, noise = _beside(known, _filled(first, curve_of(first).mean))
    moments = Moments.of(known, table, noise)
    return moments, curve_of(moments)


def with_terms(fit: ModelFit, findings: Sequence[Finding]) -> ModelFit:
    """A `fit` with the terms of all `findings` in its model."""
    for found in findings:
        fit = with_term(fit, found.term)
    return fit


def learn_term(fit: ModelFit, report: Callable[[str], None] = lambda _: None,
               pairs: Collection[Pair] | None = None) -> Finding | None:
    """The term that best explains what a `fit` leaves, as a curve; None where none convinces.

    `report` is told what is being done. Of all `pairs` (covariate, frame, what it acts on), or of
    some.
    """
    known = told(fit)
    tables = [(table, kernels(table)) for table in candidates(known)
              if pairs is None or (table.against, table.frame, table.acts_on) in pairs]
    report(f'looking for a term, against {len(tables)} pairs of covariate and frame')
    first = _best(known, tables, _noise(known))
    if first is None:
        return None
    known, noise = _beside(known, first.term)
    return _best(known, tables, noise)


def told(fit: ModelFit) -> ModelFit:
    """A `fit` whose sessions know φ of their particles."""
    return ModelFit(fit.model, tuple(
        replace(p, session=replace(p.session, phi=np.angle(p.velocity_phasor)))
        for p in fit.session_fits))


def with_term(fit: ModelFit, term: LearnedTerm) -> ModelFit:
    """A `fit` with a `term` in its model, v, φ and noise at their maximum again."""
    model = replace(fit.model, learned=(*fit.model.learned, term))
    known = told(fit)
    return fit_noise(evaluate(model, [p.session for p in known.session_fits],
                              [p.whitening for p in fit.session_fits]))


def relearn(findings: Sequence[Finding], fit: ModelFit) -> ModelFit:
    """Return a `fit` of other rows with the terms that these rows ask for.

    Among the pairs of covariate and frame that had odds of POSSIBLE or more for one of the
    `findings`.
    """
    pairs = {pair for found in findings for pair, odds in found.odds.items() if odds > POSSIBLE}
    learned = _curves(fit, learn_term(fit, pairs=pairs), pairs=pairs)
    return with_terms(fit, [with_formula(found) for found in learned])


def _noise(fit: ModelFit) -> list[float]:
    """D [m²/s] of every session."""
    return [p.diffusion for p in fit.session_fits]


def _beside(fit: ModelFit, term: LearnedTerm) -> tuple[ModelFit, list[float]]:
    """The model of a `fit` at the v and φ that a `term` leaves, and D with it, of every session.

    With what is missing in the noise, evidence would be too small, and its levels wrong.
    """
    better = with_term(fit, term)
    plain = evaluate(fit.model, [p.session for p in better.session_fits],
                     [p.whitening for p in better.session_fits])
    parts = []
    for p, other in zip(plain.session_fits, better.session_fits, strict=True):
        one = replace(p)
        vars(one)['velocity_phasor'] = other.velocity_phasor
        parts.append(one)
    return ModelFit(fit.model, tuple(parts)), _noise(better)


def _best(known: ModelFit, tables: Sequence[tuple[LearnedTerm, list[Kernel]]],
          noise: Sequence[float]) -> Finding | None:
    """The candidate of the largest evidence that foretells rows it was not learned from.

    Of `tables` with the kernels to be tried on each.
    """
    found = []
    for table, tried in tables:
        moments = Moments.of(known, table, noise)
        found.append((moments, Curve.of(tried, *moments.total)))
    found.sort(key=lambda one: -one[1].log_evidence)
    total = float(np.logaddexp.reduce([curve.log_evidence for _, curve in found]))
    odds: dict[Pair, float] = {
        (m.term.against, m.term.frame, m.term.acts_on): float(np.exp(curve.log_evidence - total))
        for m, curve in found}
    paid = float(np.log(max(len(tables), 1)))
    for rank, (moments, curve) in enumerate(found, 1):
        if curve.log_evidence - paid < CONVINCING:
            return None
        if foretells(moments) > HELD_OUT + np.log(rank):
            return Finding(_filled(moments, curve.mean), moments, curve, None,
                           curve.log_evidence - paid, odds)
    return None


def foretells(moments: Moments) -> float:
    """Gain in log likelihood of every fold of rows by the curve of the others."""
    tried = kernels(moments.term)
    return sum(moments.held_out(fold, Curve.of(tried, *moments.without_fold(fold)).mean)
               for fold in range(FOLDS))


def finish(found: Finding) -> Finding:
    """With a formula, where one beats the curve on rows it was not fitted to, and the band."""
    found = with_formula(found)
    low, high = band(found, found.formula)
    count = found.term.values.shape[1]
    return replace(found, term=replace(
        found.term, low=low.reshape(count, -1).T, high=high.reshape(count, -1).T))


def with_formula(found: Finding) -> Finding:
    """Return a finding with a formula, where one beats the curve on rows it was not fitted to."""
    formula = best_formula(found.moments)
    if formula is None or not (formula.paid > found.curve.log_evidence - DECISIVE
                               and _beats(found.moments, formula)):
        return found
    term = replace(_filled(found.moments, formula.values), formula=formula.formula.text,
                   parameters=formula.parameters)
    return replace(found, term=term, formula=formula)


def best_formula(moments: Moments) -> FittedFormula | None:
    """The formula of the grammar that pays best for its size; None where none pays."""
    gram, projection = moments.total
    rules = grammar(moments.term)
    price = float(np.log(max(len(rules), 1) / CHANCE))
    fitted = [replace(refit(rule, gram, projection), price=price) for rule in rules]
    best = max(fitted, key=lambda one: one.paid, default=None)
    return best if best is not None and best.paid > 0 else None


def _beats(moments: Moments, formula: FittedFormula) -> bool:
    """Whether a `formula` foretells rows it was not fitted to as well as the curve does.

    Within one standard error, where the simpler is preferred (Breiman et al. 1984).
    """
    tried = kernels(moments.term)
    gain = variance = 0.0
    for fold in range(FOLDS):
        parts = moments.without_fold(fold)
        again = refit(formula.formula, *parts, begin=formula.shape)
        curve = Curve.of(tried, *parts).mean
        gain += moments.held_out(fold, again.values) - moments.held_out(fold, curve)
        variance += moments.apart(fold, again.values, curve)
    return gain > -float(np.sqrt(max(variance, 0.0)))


def band(found: Finding, formula: FittedFormula | None) -> tuple[np.ndarray, np.ndarray]:
    """Ends (K·C,) each of the 95 % band at every knot, by a parametric bootstrap.

    What may be true is drawn: curves, and tables of a `formula` as often as its evidence has it,
    but never always. Data are simulated from each and gone through again, kernels, strengths and
    numbers chosen anew; how far that comes out from what was drawn makes the band.
    """
    rng = np.random.default_rng(0)
    gram = found.moments.total[0]
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    count = DRAWN if formula is None else DRAWN // 2
    possible = found.curve.draws(count, rng)
    best = found.curve.mean
    if formula is not None:
        best = formula.values
        more = np.clip(formula.paid - found.curve.log_evidence, -20.0, 20.0)
        exact = rng.random(count) < min(1 / (1 + np.exp(-more)), MOST_SURE)
        possible[exact] = best
    draws = []
    for true in possible:
        projection = gram @ true + root @ rng.standard_normal(len(values))
        again = found.curve.given(projection).mean if formula is None else refit(
            formula.formula, gram, projection, begin=formula.shape).values
        draws.append(best - (again - true))
    low, high = np.quantile(centred(found.moments, np.array(draws)), [0.025, 0.975], axis=0)
    return low, high


def centred(moments: Moments, tables: np.ndarray) -> np.ndarray:
    """Tables (..., K·C) without what v and φ absorb: the mean of a factor, or of an angle."""
    term = moments.term
    if term.acts_on == 'velocity' or term.frame == 'radial':
        return tables
    weight = np.maximum(np.diagonal(moments.grams.sum(axis=(0, 1)))[3 + moments.count:], 0.0)
    mean = tables @ weight / weight.sum()
    # Where a table does nothing, beyond what it is about, it goes on doing nothing.
    shown: np.ndarray = np.where(tables == 0, 0.0, tables - mean[..., None])
    return shown


def _filled(moments: Moments, values: np.ndarray) -> LearnedTerm:
    """The table with `values` (K·C,)."""
    term, count = moments.term, moments.term.values.shape[1]
    shown = centred(moments, values).reshape(count, -1).T
    return replace(term, values=shown, low=shown, high=shown)
