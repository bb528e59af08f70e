"""E-values where nothing is missing: their mean may be 1 at most."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench._hidden_effects import LISTED
from bench._hidden_suite import COMMANDS, blind
from microbot_ros.discovery.held_out import log_e_value
from microbot_ros.discovery.search import fit_candidate
from microbot_ros.estimation.model_fit import fit_sessions
from microbot_ros.estimation.prepared_session import prepare
from microbot_ros.model.model import Model


def null_e_value(seed: int) -> tuple[str, float]:
    """The e-value of an effect drawn by `seed` that a session without any could show; its name."""
    session = blind(200_000 + seed, COMMANDS[seed % 4], rolling=seed % 8 == 1).session
    sessions = [prepare(session)]
    plain = fit_sessions(Model.baseline(session.conditions, session.commands), sessions)
    return next(
        (name, float(np.exp(log_e_value(found.fit.model, sessions, name))))
        for name in _in_any_order(seed) if (found := fit_candidate(plain, name)))


def _in_any_order(seed: int) -> Iterator[str]:
    return iter(np.random.default_rng(seed).permutation(list(LISTED)).tolist())
