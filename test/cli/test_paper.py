"""`microbot paper`: the repeated experiment against theory and against the paper's own numbers."""

import json
import math
import re

import numpy as np
import pytest
from click.testing import CliRunner

from microbot_ros.cli import microbot
from microbot_ros.paper import repetition as experiment


def run(*arguments):
    return CliRunner().invoke(microbot, ['paper', *map(str, arguments)], catch_exceptions=False)


@pytest.fixture(scope='module')
def report(tmp_path_factory):
    out = tmp_path_factory.mktemp('paper') / 'out'
    result = run('--out', out, '--repetitions', 3, '--json', out.parent / 'copy.json')
    assert result.exit_code == 0
    return out


@pytest.fixture(scope='module')
def trials():
    return [experiment.attempt(seed) for seed in range(100, 112)]


def test_report_stands_alone_and_says_that_it_is_a_simulation(report):
    page = (report / 'report.html').read_text(encoding='utf-8')
    assert 'This is a simulation.' in page
    assert re.findall(r'src="(?!data:image/png;base64,)', page) == []
    assert page.count('src="data:image/png;base64,') == 2
    assert 'href' not in page
    for printed in ('4.11', '5.62', '4.02', '6.91', '5.56', '5.77', '4.59', '2.13', '2.04'):
        assert printed in page
    for picture in ('trajectories.png', 'errors.png'):
        assert (report / picture).read_bytes().startswith(b'\x89PNG')


def test_summary_holds_the_papers_constants_and_names_its_slip(report):
    summary = json.loads((report / 'summary.json').read_text())
    assert (report.parent / 'copy.json').read_text() == (report / 'summary.json').read_text()
    assert summary['simulation'] is True
    assert summary['seeds'] == [1, 2, 3]
    constants = summary['constants']
    assert constants['translation_us'] == pytest.approx(3.72, rel=2e-3)
    assert constants['rotation_us'] == pytest.approx(1.11, rel=5e-3)
    assert constants['distance_300_tau_nm'] == pytest.approx([4.14, 4.88, 5.55], abs=0.006)
    assert constants['printed_over_recomputed'] == pytest.approx([9.73] * 3, abs=0.02)
    assert summary['magnetic_force']['part_of_propulsion'] < 0.01


def test_solvers_give_the_same_rmse_to_three_digits(trials):
    for trial in trials:
        for approach in experiment.APPROACHES:
            assert trial.rmse[approach] == pytest.approx(trial.rmse_stokes[approach], rel=5e-4)


def test_all_four_solvers_agree_on_the_path(trials):
    trial = trials[0]
    particles = experiment.swimmers(experiment.FORCE, experiment.PHI)
    given = particles, trial.session.commands, trial.times, trial.measured[0]
    exact, *others = (solver(*given) for solver in reversed(experiment.SOLVERS.values()))
    # Euler at 0.02 s learns of a switch up to a step late; rotation lags by its 1.5 ms.
    for path in others:
        assert np.abs(path - exact).max() < 0.02 * 5e-6 * 2 * len(trial.session.commands.t)


def test_true_parameters_leave_brownian_motion_and_the_camera(trials):
    """⟨error²⟩ = 4Dt + 4σ², so its mean over the record is 2DT + 4σ²."""
    squares = np.array([trial.rmse['true'] ** 2 for trial in trials]).ravel()
    diffusion = experiment.constants()['diffusion_m2_s']
    expected = 2 * diffusion * experiment.DURATION + 4 * experiment.CAMERA.noise**2
    error = squares.std(ddof=1) / math.sqrt(len(squares))
    assert abs(squares.mean() - expected) < 4 * error


def test_mean_force_costs_all_but_the_middle_particle(trials):
    own, mean = (
        np.mean([trial.rmse[approach] for trial in trials], axis=0)
        for approach in ('own', 'mean'))
    assert mean[0] > 2 * own[0]
    assert mean[2] > 2 * own[2]
    assert mean[1] < 1.3 * own[1]
