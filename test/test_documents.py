"""The documents say what the code does: pages made from it, links, commands and snippets."""

import ast
import importlib.util
import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
import yaml
from schemas import schema_file

import microbot_ros
from microbot_ros.cli import microbot
from microbot_ros.cockpit import faults
from microbot_ros.drive.gate import Reason

ROOT = Path(__file__).parents[1]
DOCS = ROOT / 'docs'
KINDS = ('tutorial', 'how-to', 'reference', 'explanation', 'decisions')
PROSE = sorted([*DOCS.rglob('*.md'), *ROOT.glob('*.md'), *ROOT.glob('*.rst'),
                *(ROOT / 'firmware').glob('*.md')])
SOURCES = [path for place in ('microbot_ros', 'test', 'bench', 'config', 'launch', 'firmware')
           for path in sorted((ROOT / place).rglob('*'))
           if path.suffix in ('.py', '.yaml', '.html', '.md', '.c', '.h')]

LINK = re.compile(r'\]\(([^)\s]+)\)')
MENTION = re.compile(r'\bdocs/[\w./-]+\.(?:md|py)\b')
BLOCK = re.compile(r'^```(\w*)\n(.*?)^```', re.MULTILINE | re.DOTALL)


def _name(path):
    return str(path.relative_to(ROOT))


@pytest.fixture(scope='module')
def build():
    """`docs/build.py`, which is no package."""
    sys.path.insert(0, str(DOCS))
    try:
        import build
        yield build
    finally:
        sys.path.remove(str(DOCS))


@pytest.mark.parametrize('page', [
    'how-to/when_something_trips.md', 'reference/commands.md', 'reference/effects.md',
    'reference/graph.md', 'reference/parameters.md', 'reference/results.md'])
def test_pages_of_the_code_are_up_to_date(page, build):
    written = (DOCS / page).read_text(encoding='utf-8')
    assert build.PAGES[page]() == written, 'run `python docs/build.py`'


def test_every_page_of_the_code_is_tested(build):
    made = {_name(path) for path in PROSE if 'Made from the code by' in path.read_text()}
    assert made == {f'docs/{page}' for page in build.PAGES | build.NOTEBOOKS}


def test_pages_of_the_notebooks_show_their_cells(build):
    """That they show what the cells print is tested by test_notebooks.py."""
    for name in build.notebooks.NAMES:
        page = (DOCS / 'tutorial' / 'notebooks' / f'{name}.md').read_text(encoding='utf-8')
        shown = [text.rstrip() for language, text in BLOCK.findall(page) if language == 'python']
        assert shown == [text for is_text, text in build.notebooks.cells(name) if not is_text], (
            'run `python docs/build.py --notebooks`')


def test_every_sentence_of_a_fault_has_its_cause_and_cure(build):
    """A new one needs a line in microbot_ros/cockpit/faults/faults.yaml."""
    known = faults.catalogue()
    said = build.faults.sentences()
    assert {part: set(told) for part, told in said.items()} == {
        part: set(told) for part, told in known.items()}
    assert sum(map(len, said.values())) > 120, 'the reader of the code found hardly any'
    for part in known.values():
        assert [told for told, answer in part.items() if not all(map(str.strip, answer))] == []


def test_messages_of_faults_are_short_and_plain():
    """At most 100 characters before the advice; no stand-ins for a noun."""
    said = [sentence for known in faults.catalogue().values() for sentence in known]
    assert [one for one in said if len(re.split(r'[;:] ', one)[0]) > 100] == []
    assert [one for one in said
            if re.search(r'\b(?:nobody|somebody|whoever|told|mend|goes on)\b', one)] == []


@pytest.mark.parametrize('reason', Reason)
@pytest.mark.parametrize('parameters', ['', ' (deviation_A, settling_ms)'])
def test_every_fault_of_the_gate_is_shown_with_its_cause_and_cure(reason, parameters):
    cause, cure = faults.catalogue()['Faults of the gate: the words before the colon'][reason]
    said = f'disarmed, {reason}{parameters}: (0, 0) A for 0.2 s; zero, confirmed by a reading'
    assert faults.remedy(said) == faults.Remedy(cause, cure) or cure.startswith('The detail')


def test_every_sentence_of_the_catalogue_finds_a_remedy_of_as_many_words():
    for known in faults.catalogue().values():
        for sentence, (_, cure) in known.items():
            if not cure.startswith(('See there', 'See the sentence')):
                assert faults.remedy(sentence.replace('…', '4')) is not None, sentence


def test_every_topic_and_every_field_has_its_meaning(build):
    """In docs/made/graph.yaml and docs/made/results.yaml."""
    topics = yaml.safe_load(build.graph.CONTENT.read_text(encoding='utf-8'))
    assert {end.name for end in build.graph.ends()} == set(topics)
    meaning = yaml.safe_load(build.results.MEANING.read_text(encoding='utf-8'))
    assert {file: set(build.results.fields(file)) for file in meaning} == {
        file: set(fields) for file, fields in meaning.items()}


def test_each_topic_of_strings_has_a_published_schema(build):
    strings = {end.name for end in build.graph.ends() if end.kind == 'std_msgs/String'}
    for name in {*strings, 'controller/list_controllers'}:
        assert json.loads(schema_file(name).read_text(encoding='utf-8'))['title'].startswith(name)


def test_every_topic_that_is_recorded_is_in_the_reference(build):
    from microbot_ros.nodes.base.topics import CHANGES, TOPICS

    assert TOPICS.keys() - {end.name for end in build.graph.ends()} == {CHANGES}


def _anchors(path):
    """What can be linked to within a page: its headings, as GitHub and MyST spell them."""
    text = BLOCK.sub('', path.read_text(encoding='utf-8'))
    return {re.sub(r'[^\w\- ]', '', heading.lower()).strip().replace(' ', '-')
            for heading in re.findall(r'^#+ (.+)$', text, re.MULTILINE)}


@pytest.mark.parametrize('page', PROSE, ids=_name)
def test_links_lead_somewhere(page):
    text = BLOCK.sub('', page.read_text(encoding='utf-8'))
    broken = []
    for link in LINK.findall(text):
        target, _, anchor = link.partition('#')
        found = (page.parent / target).resolve() if target else page
        if re.match(r'https?://|mailto:', link):
            continue
        if not found.exists() or (anchor and anchor not in _anchors(found)):
            broken.append(link)
    assert broken == []


def test_mentions_of_documents_are_right():
    """In messages, comments, configurations and prose: a path that begins with docs/."""
    wrong = {f'{_name(path)}: {found}' for path in [*SOURCES, *PROSE]
             for found in MENTION.findall(path.read_text(encoding='utf-8', errors='replace'))
             if not (ROOT / found).exists()}
    assert wrong == set()


@pytest.mark.parametrize('page', ['README.md', 'docs/explanation/architecture.md'])
def test_the_house_has_all_its_rooms(page):
    rooms = {path.parent.name for path in (ROOT / 'microbot_ros').glob('*/__init__.py')}
    table = (ROOT / page).read_text(encoding='utf-8').partition('## The house')[2]
    cells = re.findall(r'^\| (.*?) \|', table, re.MULTILINE)
    assert rooms <= set(re.findall(r'`(\w+)`', ' '.join(cells)))


def test_every_page_is_of_a_kind():
    """Each folder lists all of its own; a page beside the folders would be in no list."""
    assert {path.name for path in DOCS.glob('*.md')} == {'index.md'}
    folders = {path.relative_to(DOCS).parts[0] for path in DOCS.rglob('*.md')} - {'index.md'}
    assert folders == set(KINDS)


def _blocks(*languages):
    for page in PROSE:
        for language, text in BLOCK.findall(page.read_text(encoding='utf-8')):
            if language in languages:
                yield page, text


def _commands():
    """Every `microbot …` of a block of shell, a word of code or an example: page, words."""
    for page, text in _blocks('', 'sh', 'text'):
        for line in text.replace('\\\n', ' ').splitlines():
            found = re.match(r'(?:\$ )?(?:\S*/)?microbot (.*)', line.strip())
            if found and '[OPTIONS]' not in line:
                yield page, found[1]
    for page in PROSE:
        text = BLOCK.sub('', page.read_text(encoding='utf-8'))
        yield from ((page, found) for found in re.findall(r'(?<!`)`microbot ([^`]+)`(?!`)', text))


def _complaint(words):
    """What is wrong with the words after `microbot`, by click's own commands; '' for nothing."""
    context, command = click.Context(microbot), microbot
    while isinstance(command, click.Group) and words and not words[0].startswith('-'):
        name, *words = words
        if not name.islower():
            return ''  # COMMAND, in prose
        command = command.get_command(context, name)
        if command is None:
            return f'no command {name}'
    known = {option for parameter in command.get_params(context)
             for option in (*parameter.opts, *parameter.secondary_opts)} | {'--version', '--help'}
    given = {word.partition('=')[0] for word in words if re.match(r'--[a-z]', word)}
    return '' if given <= known else f'no option {", ".join(given - known)}'


def test_commands_in_the_documents_exist():
    told = list(_commands())
    assert len(told) > 100
    wrong = []
    for page, line in told:
        words = shlex.split(line.replace('…', '').replace('\n', ' '), comments=True)
        if complaint := _complaint(words):
            wrong.append(f'{_name(page)}: microbot {line}: {complaint}')
    assert wrong == []


def test_make_targets_in_the_documents_exist():
    targets = set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    told = {found for page in PROSE for found in re.findall(
        r'(?:^|`)make ([\w-]+)', page.read_text(encoding='utf-8'), re.MULTILINE)}
    assert {'demo', 'test', 'test-rig', 'docs'} <= told <= targets


def test_python_in_the_documents_imports_what_there_is():
    """Every block of Python compiles, and what it imports of ours can be imported."""
    for page, text in _blocks('python'):
        tree = ast.parse(text, str(page))
        for node in ast.walk(tree):
            names = []
            if isinstance(node, ast.ImportFrom) and node.module:
                module = importlib.import_module(node.module)
                names = [alias.name for alias in node.names]
                assert [name for name in names if not hasattr(module, name)] == [], page
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    assert importlib.util.find_spec(alias.name), (page, alias.name)


def test_yaml_in_the_documents_is_yaml():
    blocks = list(_blocks('yaml'))
    assert blocks
    for _, text in blocks:
        yaml.safe_load(text.replace('…', 'more'))


@pytest.mark.rig
def test_sphinx_builds_the_pages_without_a_warning(tmp_path):
    """But for the API, which takes a minute: `make docs`."""
    built = subprocess.run(
        [sys.executable, '-m', 'sphinx', '-q', '-t', 'prose', '-b', 'html', '-d',
         tmp_path / 'read', DOCS, tmp_path / 'html'],
        capture_output=True, text=True, timeout=110)
    assert [line for line in built.stderr.splitlines() if 'glob pattern' not in line] == []
    assert (tmp_path / 'html' / 'how-to' / 'when_something_trips.html').is_file()


def test_files_for_other_programs_are_as_these_want_them():
    """CITATION.cff, the issue forms and the devcontainer: read by sites, noticed late."""
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text(encoding='utf-8'))
    assert {'cff-version', 'message', 'title', 'authors'} <= citation.keys()
    assert citation['version'] == microbot_ros.__version__
    assert 'Multiple Microrobots' in citation['references'][0]['title']
    for form in (ROOT / '.github' / 'ISSUE_TEMPLATE').glob('*.md'):
        head = yaml.safe_load(form.read_text(encoding='utf-8').split('---\n')[1])
        assert {'name', 'about'} <= head.keys(), form
    container = json.loads((ROOT / '.devcontainer' / 'devcontainer.json').read_text())
    assert (ROOT / '.devcontainer' / container['build']['dockerfile']).is_file()


def test_the_checks_of_a_change_run_what_there_is():
    """Every job of the workflow, on every Python that is claimed, by commands of the Makefile."""
    workflow = yaml.safe_load((ROOT / '.github' / 'workflows' / 'checks.yml').read_text())
    jobs = workflow['jobs']
    ran = {name: ' '.join(step.get('run', '') for step in job['steps'])
           for name, job in jobs.items()}
    targets = set(re.findall(r'^([\w-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    told = set(re.findall(r'\bmake ([\w-]+)', ' '.join(ran.values())))
    assert {'test', 'test-rig', 'lowest', 'docs'} <= told <= targets
    for job in ('tests', 'rig'):
        assert jobs[job]['strategy']['matrix']['python'] == ['3.11', '3.12']
    page = (DOCS / 'how-to' / 'with_ros.md').read_text(encoding='utf-8')
    for command in ('python3 -m venv --system-site-packages .venv', 'touch .venv/COLCON_IGNORE',
                    'python -m colcon build', 'source /opt/ros/jazzy/setup.bash'):
        assert command in page
        assert command in ran['ros']


def test_the_layout_of_foxglove_shows_what_the_nodes_send(build):
    """Every topic that it names exists, and every panel that is laid out is described."""
    layout = json.loads((ROOT / 'config' / 'layout.json').read_text(encoding='utf-8'))
    text = json.dumps(layout['configById'])
    named = set(re.findall(r'"/([a-z_]+(?:/[a-z_]+)*)', text)) - {'diagnostics'}
    assert len(named) >= 7
    assert named <= {end.name for end in build.graph.ends()}
    assert set(layout['configById']) == set(re.findall(
        r'"((?:\w|3D)+!\w+)"', json.dumps(layout['layout'])))


def test_tests_that_the_safety_case_names_exist() -> None:
    """A name that ends in … is the beginning of one."""
    text = (ROOT / 'docs/explanation/safety_evidence.md').read_text(encoding='utf-8')
    files = list((ROOT / 'test').rglob('test_*.py'))
    known = {file.name for file in files} | {
        name for file in files for name in re.findall(r'def (test_\w+)', file.read_text('utf-8'))}
    named = re.findall(r'`(?:[\w/.]+::)?…?((?:test_)?\w+(?:\.py)?)(…?)`', text)
    missing = [name for name, more in named if name.startswith('test_') and not (
        any(one.startswith(name) for one in known) if more else name in known)]
    assert len(named) > 40
    assert not missing
