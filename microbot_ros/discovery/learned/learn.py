"""Learning of a term from residuals: covariate and frame, curve, formula, and certainty."""

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
"""Log evidence that a term must have, after the cost of all candidates.

Choice: odds of 1000 to 1, more than for a name (FALSE): a term has more freedom than an effect.
"""

HELD_OUT = float(np.log(20))
"""Gain in log likelihood that a curve must bring to held-out rows, plus log n for the n-th
candidate.

Choice: odds of 20 to 1. It guards against structure in a part of the recording only."""

POSSIBLE = 1e-3
"""Posterior probability of a covariate and frame above which it is tried again in a fold of rows.

Choice: a smaller value costs time, a larger one may leave out the pair that the fold favours.
"""

Pair = tuple[str, str, str]
"""Covariate, frame and acted-on quantity of a term."""

MOST = 3
"""Maximum number of learned terms. Choice: more are hard to read; what is left is reported."""

CHANCE = 0.05
"""Probability p in the PASTIS cost k ln(n₀/p) of k parameters of one of n₀ formulas: the usual 5
%."""

DECISIVE = 5.0
"""Log evidence by which a curve excludes a formula (Kass and Raftery 1995: very strong)."""

MOST_SURE = 0.8
"""Maximum probability of a formula among possible tables: the grammar is small.

Choice: a larger value makes bands too narrow where no formula is right, a smaller one too wide.
"""

DRAWN = 120
"""Number of bootstrap tables per band. Choice: the 2.5 % quantile then rests on three tables."""


@dataclass(frozen=True)
class Finding:
    """A term learned beside a fit.

    Attributes
    ----------
    term : LearnedTerm
        Table of the posterior mean, or of the formula.
    moments : Moments
        Moments of the data for the table.
    curve : Curve
        Posterior of the table.
    formula : FittedFormula or None
        Formula, if one predicts better than the curve.
    log_evidence : float
        Log Bayes factor against no term, less the cost of all candidates.
    odds : dict of Pair to float
        Posterior probability of all candidates, largest first.
    """

    term: LearnedTerm
    moments: Moments
    curve: Curve
    formula: FittedFormula | None
    log_evidence: float
    odds: dict[Pair, float]

    @property
    def gain(self) -> float:
        """Gain in log likelihood by the term."""
        gram, projection = self.moments.total
        values = self.curve.mean
        return float(projection @ values - 0.5 * values @ gram @ values)


def learn_terms(fit: ModelFit, first: Finding | None,
                report: Callable[[str], None] = lambda _: None) -> tuple[Finding, ...]:
    """Learn the terms that explain the residual of a fit, one after the other.

    Each term is learned beside the ones before it; all are then learned again beside each other.

    Parameters
    ----------
    fit : ModelFit
        Fit whose residual is explained.
    first : Finding or None
        Result of `learn_term` for this fit.
    report : callable, optional
        Receives one line of progress.

    Returns
    -------
    tuple of Finding
        With formulas and bands; empty if no term is convincing.
    """
    return tuple(map(finish, _curves(fit, first, report)))


def _curves(fit: ModelFit, first: Finding | None,
            report: Callable[[str], None] = lambda _: None,
            pairs: Collection[Pair] | None = None) -> list[Finding]:
    """Return the terms of `learn_terms` as curves without formula or band."""
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
    """Learn each of several terms again from the residual of a fit with all others.

    Parameters
    ----------
    fit : ModelFit
        Fit without the terms.
    findings : sequence of Finding
        The terms.

    Returns
    -------
    list of Finding
        With new moments, curves and tables, in the same order.
    """
    learned = list(findings)
    for k in range(len(learned)):
        others = [one for i, one in enumerate(learned) if i != k]
        moments, curve = _moments_of(with_terms(fit, others), learned[k].moments.term)
        learned[k] = replace(learned[k], moments=moments, curve=curve,
                             term=_filled(moments, curve.mean))
    return learned


def _moments_of(fit: ModelFit, table: LearnedTerm) -> tuple[Moments, Curve]:
    """Return moments and curve of a `table`, at the noise that remains beside it."""
    known = told(fit)
    first = Moments.of(known, table, _noise(known))
    known, noise = _beside(known, _filled(first, curve_of(first).mean))
    moments = Moments.of(known, table, noise)
    return moments, curve_of(moments)


def with_terms(fit: ModelFit, findings: Sequence[Finding]) -> ModelFit:
    """Add the terms of several findings to a fit.

    Parameters
    ----------
    fit : ModelFit
        Fit without the terms.
    findings : sequence of Finding
        The terms.

    Returns
    -------
    ModelFit
        Fit with v, φ and noise at their maximum.
    """
    for found in findings:
        fit = with_term(fit, found.term)
    return fit


def learn_term(fit: ModelFit, report: Callable[[str], None] = lambda _: None,
               pairs: Collection[Pair] | None = None) -> Finding | None:
    """Learn the term that best explains the residual of a fit, as a curve.

    Parameters
    ----------
    fit : ModelFit
        Fit whose residual is explained.
    report : callable, optional
        Receives one line of progress.
    pairs : collection of Pair, optional
        Candidates; by default all.

    Returns
    -------
    Finding or None
        None if no candidate is convincing.
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
    """Fix φ of every particle in the sessions of a fit, for terms that depend on the heading.

    Parameters
    ----------
    fit : ModelFit
        Any fit.

    Returns
    -------
    ModelFit
        The fit, with φ in its sessions.
    """
    return ModelFit(fit.model, tuple(
        replace(p, session=replace(p.session, phi=np.angle(p.velocity_phasor)))
        for p in fit.session_fits))


def with_term(fit: ModelFit, term: LearnedTerm) -> ModelFit:
    """Add a term to a fit and maximise v, φ and noise again.

    Parameters
    ----------
    fit : ModelFit
        Fit without the term.
    term : LearnedTerm
        The term.

    Returns
    -------
    ModelFit
        Fit with the term.
    """
    model = replace(fit.model, learned=(*fit.model.learned, term))
    known = told(fit)
    return fit_noise(evaluate(model, [p.session for p in known.session_fits],
                              [p.whitening for p in fit.session_fits]))


def relearn(findings: Sequence[Finding], fit: ModelFit) -> ModelFit:
    """Learn terms again from other rows, and add them to a fit of these.

    Candidates are the pairs of covariate and frame with a probability above POSSIBLE in one of the
    findings.

    Parameters
    ----------
    findings : sequence of Finding
        Terms learned from all rows.
    fit : ModelFit
        Fit of the other rows.

    Returns
    -------
    ModelFit
        Fit with the terms that these rows support.
    """
    pairs = {pair for found in findings for pair, odds in found.odds.items() if odds > POSSIBLE}
    learned = _curves(fit, learn_term(fit, pairs=pairs), pairs=pairs)
    return with_terms(fit, [with_formula(found) for found in learned])


def _noise(fit: ModelFit) -> list[float]:
    """Return D [m²/s] of every session."""
    return [p.diffusion for p in fit.session_fits]


def _beside(fit: ModelFit, term: LearnedTerm) -> tuple[ModelFit, list[float]]:
    """Return the model of a `fit` at the v and φ beside a `term`, and D of every session.

    Noise that contains missing structure would make the evidence too small, and its levels wrong.
    """
    better = with_term(fit, term)
    plain = evaluate(fit.model, [p.session for p in better.session_fits],
                     [p.whitening for p in better.session_fits])
    parts = tuple(replace(p, phasor=other.velocity_phasor) for p, other in zip(
        plain.session_fits, better.session_fits, strict=True))
    return ModelFit(fit.model, parts), _noise(better)


def _best(known: ModelFit, tables: Sequence[tuple[LearnedTerm, list[Kernel]]],
          noise: Sequence[float]) -> Finding | None:
    """Return the candidate of the largest evidence that predicts held-out rows.

    `tables` are pairs of a table and the kernels to be tried on it.
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
    """Return the gain in log likelihood of held-out rows by a curve.

    Parameters
    ----------
    moments : Moments
        Moments of the candidate.

    Returns
    -------
    float
        Sum over folds, each with the curve of the other folds.
    """
    tried = kernels(moments.term)
    return sum(moments.held_out(fold, Curve.of(tried, *moments.without_fold(fold)).mean)
               for fold in range(FOLDS))


def finish(found: Finding) -> Finding:
    """Add a formula, if one predicts held-out rows better than the curve, and a band.

    Parameters
    ----------
    found : Finding
        A term as a curve.

    Returns
    -------
    Finding
        With `formula`, and 95 % band in `term.low` and `term.high`.
    """
    found = with_formula(found)
    low, high = band(found, found.formula)
    count = found.term.values.shape[1]
    return replace(found, term=replace(
        found.term, low=low.reshape(count, -1).T, high=high.reshape(count, -1).T))


def with_formula(found: Finding) -> Finding:
    """Add a formula to a finding, if one predicts held-out rows better than the curve.

    Parameters
    ----------
    found : Finding
        A term as a curve.

    Returns
    -------
    Finding
        With the table of the formula, or unchanged.
    """
    formula = best_formula(found.moments)
    if formula is None or not (formula.paid > found.curve.log_evidence - DECISIVE
                               and _beats(found.moments, formula)):
        return found
    term = replace(_filled(found.moments, formula.values), formula=formula.formula.text,
                   parameters=formula.parameters)
    return replace(found, term=term, formula=formula)


def best_formula(moments: Moments) -> FittedFormula | None:
    """Return the formula with the largest gain after the cost of its parameters.

    Parameters
    ----------
    moments : Moments
        Moments of the candidate.

    Returns
    -------
    FittedFormula or None
        None if no formula gains more than it costs.
    """
    gram, projection = moments.total
    rules = grammar(moments.term)
    price = float(np.log(max(len(rules), 1) / CHANCE))
    fitted = [replace(refit(rule, gram, projection), price=price) for rule in rules]
    best = max(fitted, key=lambda one: one.paid, default=None)
    return best if best is not None and best.paid > 0 else None


def _beats(moments: Moments, formula: FittedFormula) -> bool:
    """Return whether a `formula` predicts held-out rows as well as the curve.

    Within one standard error, where the simpler model is preferred (Breiman et al. 1984).
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
    """Return the 95 % band of a table by a parametric bootstrap.

    Possible tables are drawn from the posterior of the curve and, in proportion to its evidence
    but never always, from the formula. Data are simulated from each table and analysed again, with
    kernels, strengths and parameters selected anew. The deviations from the drawn tables make the
    band.

    Parameters
    ----------
    found : Finding
        A learned term.
    formula : FittedFormula or None
        Its formula.

    Returns
    -------
    low, high : ndarray, shape (K·C,)
        Ends of the band at each knot.
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
    """Remove from tables what v and φ absorb: the mean of a factor or of an angle.

    Parameters
    ----------
    moments : Moments
        Moments of the table.
    tables : ndarray, shape (..., K·C)
        Values at the knots.

    Returns
    -------
    ndarray, shape (..., K·C)
        Of weighted mean 0; zeros stay zero. Velocities and radial terms are unchanged.
    """
    term = moments.term
    if term.acts_on == 'velocity' or term.frame == 'radial':
        return tables
    weight = np.maximum(np.diagonal(moments.grams.sum(axis=(0, 1)))[3 + moments.count:], 0.0)
    mean = tables @ weight / weight.sum()
    # Zeros beyond the data stay zero.
    shown: np.ndarray = np.where(tables == 0, 0.0, tables - mean[..., None])
    return shown


def _filled(moments: Moments, values: np.ndarray) -> LearnedTerm:
    """Return the table with `values` (K·C,)."""
    term, count = moments.term, moments.term.values.shape[1]
    shown = centred(moments, values).reshape(count, -1).T
    return replace(term, values=shown, low=shown, high=shown)
