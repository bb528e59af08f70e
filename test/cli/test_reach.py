"""`microbot reach` from its command line."""

import json

import pytest
from click.testing import CliRunner

from microbot_ros.cli.reach import command
from microbot_ros.common.errors import InputError

TWO = ['--particle', '4,0', '--particle', '4,2', '--at', '0,0', '--at', '30,0',
       '--goal', '20,0', '--goal', '30,-15']


def run(*arguments):
    return CliRunner().invoke(command, list(arguments), catch_exceptions=False)


def test_says_and_draws_what_can_be_reached(tmp_path):
    picture, numbers = tmp_path / 'reach.png', tmp_path / 'reach.json'
    result = run(*TWO, '--alignment-times-s', '0.1,0.3', '--figure', str(picture),
                 '--json', str(numbers))
    assert result.exit_code == 0
    assert '2 of 4 dimensions' in result.output
    assert picture.stat().st_size > 10_000
    found = json.loads(numbers.read_text())
    # By hand: c = 4, 4e^{2i}; d = 20, −15i; U = Σ c̄ d / Σ |c|².
    assert found['floor_um'] == pytest.approx(17.11, abs=0.01)
    assert found['planned_floor_um'] < 0.2
    assert min(found['opened_um']['off']) > 1


def test_equal_particles_open_nothing(tmp_path):
    numbers = tmp_path / 'reach.json'
    assert run(*TWO, '--json', str(numbers)).exit_code == 0
    found = json.loads(numbers.read_text())
    assert max(found['opened_um']['off']) < 1e-6
    assert found['planned_floor_um'] >= found['floor_um'] - 1e-6


@pytest.mark.parametrize(('arguments', 'complaint'), [
    (['--at', '0,0', '--goal', '1,1'], 'expected --model FILE or --particle'),
    ([*TWO, '--goal', '1,1'], '--goal: expected one for each of 2 particles'),
    ([*TWO, '--at', '1,1'], '--at: expected one for each of 2 particles'),
    ([*TWO, '--alignment-times-s', '0.1'], 'expected 2 positive times'),
    ([*TWO, '--alignment-times-s', '0.1,-1'], 'expected 2 positive times'),
    ([*TWO, '--alignment-times-s', '0.1,inf'], 'expected 2 positive times'),
    (['--particle', '1e300,0', '--at', '0,0', '--goal', '1,1'], "received '1e300,0'"),
    (['--particle', '4,nan', '--at', '0,0', '--goal', '1,1'], "received '4,nan'"),
    (['--particle', '0,1', '--at', '0,0', '--goal', '1,1'], 'speeds of 0.001 µm/s or more'),
    (['--particle', '1e-300,1', '--at', '0,0', '--goal', '1,1'], 'speeds of 0.001 µm/s or more'),
    ([*TWO, '--figure', 'absent/reach.png'], 'absent/reach.png: expected a PNG'),
    ([*TWO, '--figure', 'reach.doc'], r'reach\.doc: expected a PNG'),
    (['--particle', '4', '--at', '0,0', '--goal', '1,1'], 'expected V_UM_S,PHI_RAD'),
    (['--model', 'absent.yaml', '--at', '0,0', '--goal', '1,1'], 'absent.yaml')])
def test_bad_input_is_named(arguments, complaint, tmp_path):
    numbers = tmp_path / 'reach.json'
    with pytest.raises(InputError, match=complaint):
        run(*arguments, '--json', str(numbers))
    assert not numbers.exists()


def test_one_particle_can_go_anywhere(tmp_path):
    picture = tmp_path / 'reach.svg'
    result = run('--particle', '4,1', '--at', '0,0', '--goal', '9,9', '--figure', str(picture))
    assert 'floor 0.00' in result.output
    assert picture.exists()


@pytest.mark.parametrize('option', ['--seconds', '--field-mt'])
@pytest.mark.parametrize('value', ['nan', 'inf', '0', '-1'])
def test_numbers_out_of_range_are_refused(option, value):
    result = run(*TWO, option, value)
    assert result.exit_code == 2
    assert option in result.output
