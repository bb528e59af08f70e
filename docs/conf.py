"""How Sphinx builds the documents: `make docs`. rosdoc2 reads this file too."""

import sys
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

import microbot_ros  # noqa: E402

project = 'microbot_ros'
author = copyright = 'microbot_ros maintainers'  # noqa: A001 - Sphinx's word
release = version = microbot_ros.__version__

extensions = [
    'myst_parser', 'sphinx.ext.autodoc', 'sphinx.ext.autosummary', 'sphinx.ext.napoleon']
napoleon_google_docstring = False
napoleon_use_ivar = True  # autodoc lists the fields of dataclasses itself
myst_enable_extensions = ['colon_fence']
exclude_patterns = ['examples', 'template']
if tags.has('prose'):  # noqa: F821 - Sphinx's own; `-t prose` leaves out what docstrings say
    exclude_patterns.append('reference/api/*.rst')
myst_heading_anchors = 3
# Links to folders of the sources lead nowhere in HTML; test/test_documents.py follows them all.
# Docstrings are for a terminal too, and no strict reStructuredText.
suppress_warnings = ['myst.xref_missing', 'docutils', 'autodoc', 'ref.python',
                     'toc.empty_glob']
default_role = 'code'

html_theme = 'furo'
html_title = f'microbot_ros {release}'
html_copy_source = False
html_static_path = ['_static']
html_css_files = ['width.css']

autodoc_member_order = 'bysource'
autosummary_generate = False  # the tables lead to the sections below them
autodoc_default_options = {'members': True, 'ignore-module-all': True}
# What drives cameras and policies need not be there to read what a room offers.
autodoc_mock_imports = ['gi', 'pymmcore', 'pypylon', 'onnxruntime']


def setup(app: Sphinx) -> None:
    """A page for each room, with all that it makes public, made when the documents are."""
    app.connect('builder-inited', lambda app: app.tags.has('prose') or _write_rooms())


def _write_rooms() -> None:
    package = Path(microbot_ros.__file__).parent
    for room in sorted(path.parent for path in package.glob('*/__init__.py')):
        modules = ['.'.join(path.relative_to(room).with_suffix('').parts)
                   for path in sorted(room.rglob('*.py')) if not path.name.startswith('_')]
        name = f'{package.name}.{room.name}'
        text = '\n'.join([
            f'{room.name}\n{"=" * len(room.name)}\n', f'.. automodule:: {name}\n',
            '.. autosummary::\n', *(f'   {module}' for module in modules), '',
            *(f'{module}\n{"-" * len(module)}\n\n.. automodule:: {name}.{module}\n'
              for module in modules)])
        page = DOCS / 'reference' / 'api' / f'{room.name}.rst'
        if not page.exists() or page.read_text(encoding='utf-8') != text:
            page.write_text(text, encoding='utf-8')
