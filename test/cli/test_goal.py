"""`microbot goal` from its command line; what becomes of goals is tested with the node."""

import pytest
from command_line import runner

from microbot_ros.cli.rig.goal import command
from microbot_ros.common.errors import InputError, RigError
from microbot_ros.nodes.client import graph_client, rig_client


class Graph:
    """Stands in for a running graph: notes what is sent, and answers with its progress."""

    answers = ()
    controller = 'waypoint'

    def __init__(self, namespace='/'):
        self.sent = []
        Graph.last = self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def send_goals(self, places, particles=None):
        self.sent.append(('goals', places, particles))
        return rig_client.Taken(5.0, self.controller)

    def send_path(self, places):
        self.sent.append(('path', places))
        return rig_client.Taken(5.0, self.controller)

    left = ()

    def watch_progress(self, tell):
        self.tell, self.left = tell, list(self.answers)

    def watch_health(self, tell):
        for level, sentence in ((b'\0', 'driving'), (b'\1', 'not armed'), (b'\1', 'not armed')):
            tell('coil_driver', level, sentence, {})
        tell('tracker', b'\1', 'no frames', {})

    def runs(self, node):
        return True

    def until(self, true, seconds):
        while not true() and self.left:
            stamp, sentence, values = self.left.pop(0)
            stamps = {'goals_stamp_s': str(stamp), 'path_stamp_s': '0.0'}
            self.tell(b'\0', sentence, stamps | values)


@pytest.fixture(autouse=True)
def graph(monkeypatch):
    monkeypatch.setattr(graph_client, 'GraphClient', Graph)


def run(*arguments):
    return runner().invoke(command, list(arguments))


def test_positions_may_be_negative():
    assert run('20,-5', '-20,20').exit_code == 0
    assert Graph.last.sent == [
        ('goals', [pytest.approx((20e-6, -5e-6)), pytest.approx((-20e-6, 20e-6))], None)]


@pytest.mark.parametrize(('content', 'particles'), [
    ('x_um,y_um\n1,2\n-3,4.5\n', None), ('particle,x_um,y_um\n7,1,2\n0,-3,4.5\n', [7, 0])])
def test_goals_from_a_file(tmp_path, content, particles):
    file = tmp_path / 'goals.csv'
    file.write_text(content)
    assert run('--file', str(file)).exit_code == 0
    assert Graph.last.sent == [('goals', [(1e-6, 2e-6), (-3e-6, 4.5e-6)], particles)]


def test_a_path_and_to_cancel_both():
    assert run('--path', '0,0', '10,0').exit_code == 0
    assert Graph.last.sent == [('path', [(0, 0), pytest.approx((1e-5, 0))])]
    assert run('--cancel').output == 'cancelled\n'
    assert Graph.last.sent == [('path', []), ('goals', [], None)]


def test_waits_for_the_arrival_at_these_goals(monkeypatch):
    done = {'result': 'ok', 'done': 'True'}
    far = (5.0, 'far', {'result': 'ok'})
    monkeypatch.setattr(Graph, 'answers', [(4.0, 'old', done), far, (5.0, 'near', done)])
    result = run('1,1', '--wait', '60')
    assert (result.exit_code, result.stdout, result.stderr) == (
        0, 'arrived\n', 'coil_driver: not armed\nfar\n')
    monkeypatch.setattr(Graph, 'answers', [far])
    result = run('1,1', '--wait', '0.01')
    assert (result.exit_code, result.stdout) == (1, 'not arrived: far\n')


@pytest.mark.parametrize('arguments', [
    ('1,1',), ('1,1', '--wait', '60'), ('--path', '1,1', '2,2')])
def test_goals_that_are_refused_are_no_success(monkeypatch, arguments):
    kind = 'path' if '--path' in arguments else 'goals'
    monkeypatch.setattr(Graph, 'controller', 'swarm')
    monkeypatch.setattr(Graph, 'answers', [
        (4.0, 'goal 7 is outside', {'result': 'bad goal'}),  # of others
        (5.0, 'no poses since', {'result': 'stale poses'}),
        (5.0, 'goal 1 is outside', {'result': 'bad goal', f'{kind}_stamp_s': '5.0'})])
    result = run(*arguments)
    assert isinstance(result.exception, RigError)
    assert str(result.exception) == 'goal 1 is outside'
    assert 'taken' not in result.output


def test_goals_that_others_replaced_are_waited_for_no_longer(monkeypatch):
    done, on = {'result': 'ok', 'done': 'True'}, {'result': 'ok'}
    monkeypatch.setattr(Graph, 'answers', [
        (5.0, 'far', on), (6.0, 'elsewhere', on), (6.0, 'there', done), (5.0, 'near', done)])
    result = run('1,1', '--wait', '60')
    assert (result.exit_code, result.stdout) == (
        1, 'not arrived: other goals have replaced these\n')
    monkeypatch.setattr(Graph, 'answers', [(5.0, 'far', on), (0.0, 'waits', on)])
    result = run('1,1', '--wait', '60')
    assert (result.exit_code, result.stdout) == (
        1, 'not arrived: the controller no longer has these goals\n')
    monkeypatch.setattr(Graph, 'answers', ())
    result = run('1,1', '--wait', '60')
    assert (result.exit_code, result.stdout) == (
        1, 'not arrived: the controller stopped publishing\n')


@pytest.mark.parametrize(('controller', 'arguments', 'said'), [
    ('waypoint', ('1,1',), "1 goal accepted by controller 'waypoint'\n"),
    ('path_following', ('--path', '1,1', '2,2', '--namespace', 'rig_2'),
     "path of 2 points accepted by controller 'path_following'\n")])
def test_who_took_them_is_told_and_what_keeps_them_from_being_acted_on(
        monkeypatch, controller, arguments, said):
    monkeypatch.setattr(Graph, 'controller', controller)
    result = run(*arguments)
    assert (result.exit_code, result.stdout) == (0, said)
    assert result.stderr == 'coil_driver: not armed\n'


@pytest.mark.parametrize(('content', 'complaint'), [
    (None, 'goals.csv: expected a readable CSV file'), ('', 'found an empty file'),
    ('x_um,y_um\n', 'expected rows'), ('x_um,y_um\n1,nan\n', r'goals\.csv:2: expected a number'),
    ('x_um,y_um\n1,inf\n', r'goals\.csv:2'), ('x,y\n1,1\n', 'expected the header x_um,y_um'),
    ('x_um,y_um,particle\n1,1,-1\n', r'goals\.csv:2: expected whole numbers'),
    ('x_um,y_um,particle\n1,1,0.5\n', r'goals\.csv:2: expected whole numbers')])
def test_a_file_that_is_wrong_is_named(tmp_path, content, complaint):
    file = tmp_path / 'goals.csv'
    if content is not None:
        file.write_text(content)
    with pytest.raises(InputError, match=complaint):
        runner().invoke(command, ['--file', str(file)], catch_exceptions=False)


@pytest.mark.parametrize('text', ['nan,1', '1,inf', '1', '1,2,3', 'a,b', '--wiat'])
def test_a_position_that_is_none_is_named(text):
    with pytest.raises(InputError, match='expected X_UM,Y_UM'):
        runner().invoke(command, ['1,1', text], catch_exceptions=False)


@pytest.mark.parametrize('arguments', [
    (), ('1,1', '--cancel'), ('--cancel', '--wait', '3'), ('--path', '1,1', '--wait', '3'),
    ('1,1', '--wait', '-1'), ('1,1', '--wait', 'nan')])
def test_what_does_not_go_together(arguments):
    assert run(*arguments).exit_code == 2
