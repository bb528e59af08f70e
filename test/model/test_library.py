"""The library of effects with those of other packages: their order, and what is refused."""

import sys

import pytest

from microbot_ros.common.errors import InputError
from microbot_ros.model.effects import BUILT_IN, EFFECTS
from microbot_ros.model.library import Library
from microbot_ros.model.model import Model

HEAD = """
from dataclasses import dataclass
from microbot_ros.model.effect import Effect
from microbot_ros.model.parameter import parameter
"""
GOOD = """
@dataclass(frozen=True)
class Late(Effect):
    '''Nothing.'''
    id = 'late'
    stage = 'heading'
    summary = 'It is late.'
    required_excitation = 'any'
    confounded_with = ('alignment_lag',)
    size: float = parameter('size', 'how much', 0.0, 1.0, 0.1)
"""


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Makes packages with one module each, as an installer leaves them on Python's path."""
    def add(package, source, point):
        folder = tmp_path / package
        about = folder / f'{package}-1.2.dist-info'
        about.mkdir(parents=True)
        (folder / f'{package}.py').write_text(source)
        (about / 'METADATA').write_text(f'Metadata-Version: 2.1\nName: {package}\nVersion: 1.2\n')
        (about / 'entry_points.txt').write_text(f'[microbot_ros.effects]\n{point}\n')
        monkeypatch.delitem(sys.modules, package, raising=False)
        monkeypatch.syspath_prepend(str(folder))
    return add


def test_without_other_packages_there_are_the_built_in_ones():
    assert list(EFFECTS.values())[:len(BUILT_IN)] == list(BUILT_IN)
    assert 'gravity' not in EFFECTS
    assert EFFECTS.get('gravity') is None


def test_an_effect_of_another_package_acts_last_in_its_stage(install):
    install('lab_late', HEAD + GOOD, 'late = lab_late:Late')
    library = Library(BUILT_IN)
    names = list(library)
    assert len(library) == len(BUILT_IN) + 1
    assert names.index('late') == names.index('heading_slip') + 1
    assert [name for name in names if name != 'late'] == [e.id for e in BUILT_IN]
    plain = [library[name].null() for name in names]
    for given in (plain, plain[::-1]):
        model = Model(1e-3, effects=tuple(given))
        assert [e.id for e in model.effects] == names
        assert model == model.with_vector(model.vector())


def spoilt(old, new):
    assert old in GOOD
    return HEAD + GOOD.replace(old, new)


@pytest.mark.parametrize(('source', 'point', 'expected'), [
    ('import nothing_of_that_name', 'late = lab_bad:Late',
     "expected 'lab_bad:Late' to load; ModuleNotFoundError: No module named 'nothing_of_that"),
    ('', 'late = lab_bad:Late', "expected 'lab_bad:Late' to load; AttributeError"),
    ('raise SystemError("first\\nsecond")', 'late = lab_bad:Late', 'SystemError: first second'),
    ('Late = 3', 'late = lab_bad:Late', "expected 'lab_bad:Late' to be a class that derives"),
    ('class Late: pass', 'late = lab_bad:Late', 'to be a class that derives from Effect'),
    (HEAD + GOOD, 'later = lab_bad:Late', "expected the 'id' later, as in the entry point; "
                                          'received'),
    (spoilt("    id = 'late'\n", ''), 'late = lab_bad:Late', "the 'id' late, .* received None"),
    (spoilt("'heading'", "'steering'"), 'late = lab_bad:Late',
     "expected a 'stage' that is one of: field, heading, velocity, observation"),
    (spoilt("    summary = 'It is late.'\n", ''), 'late = lab_bad:Late', "expected a 'summary'"),
    (spoilt("    required_excitation = 'any'\n", ''), 'late = lab_bad:Late',
     "expected a 'required_excitation'"),
    (spoilt("('alignment_lag',)", "('gravity',)"), 'late = lab_bad:Late',
     "'confounded_with': no effect 'gravity' is known; expected some of: command_delay, "),
    (spoilt('@dataclass(frozen=True)', ''), 'late = lab_bad:Late', 'expected a frozen dataclass'),
    (spoilt("parameter('size', 'how much', 0.0, 1.0, 0.1)", '1.0'), 'late = lab_bad:Late',
     r'expected one field or more, each declared with parameter\(...\)'),
    (spoilt("parameter('size'", "parameter('size_um'").replace('size:', 'length:'),
     'late = lab_bad:Late', "expected the field 'length' to be called 'size'"),
])
def test_what_cannot_be_used_is_refused_in_one_line(install, source, point, expected):
    install('lab_bad', source, point)
    with pytest.raises(InputError, match=expected) as refused:
        list(Library(BUILT_IN))
    name = point.split(' ')[0]
    assert str(refused.value).startswith(f"effect '{name}' of lab_bad 1.2: ")
    assert '\n' not in str(refused.value)


def test_a_name_can_be_had_once(install):
    install('lab_one', HEAD + GOOD, 'late = lab_one:Late')
    install('lab_two', HEAD + GOOD, 'late = lab_two:Late')
    with pytest.raises(InputError, match=r"effect 'late' of lab_\w+ 1.2: expected a name of its "
                       r'own; lab_\w+ 1.2 has an effect of that name'):
        list(Library(BUILT_IN))


def test_the_name_of_a_built_in_effect_is_taken(install):
    install('lab_flow', HEAD + GOOD, 'linear_flow = lab_flow:Late')
    with pytest.raises(InputError, match='expected a name of its own; microbot_ros has'):
        list(Library(BUILT_IN))
