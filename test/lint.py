"""What ruff and mypy do not check of the package: `make lint` runs it.

* Every public function, class and method has a docstring that describes its parameters. A
  parameter is described where the docstring of the function or of its class names it, as an
  identifier or in words (`frame_rate`: 'frame rate'), or where its annotation is a type of ours,
  whose own docstring describes it, or one that leaves nothing to say. What overrides inherits.
* Every public function, class and method has the sections of numpydoc: `Parameters` lists the
  parameters of the signature, all of them and no others; `Returns` or `Yields` says what comes
  back.
* Every constant number has a string below it, or a comment, that says where it is from.
* Imports run one way, file by file: what one file needs of another never leads back to it.
* A legend has a place: matplotlib searches for the best one, and warns where that takes over 1 s,
  as on a busy machine.
* What is compiled uses the cache that many processes may share.
"""

import ast
import gc
import re
import sys
from functools import cache
from itertools import pairwise
from pathlib import Path

from numpydoc.docscrape import NumpyDocString

import microbot_ros

ROOT = Path(microbot_ros.__file__).parent
ROOMS = sorted({
    path.relative_to(ROOT).parts[0].removesuffix('.py') for path in ROOT.rglob('*.py')}
    - {'__init__'})

_SAYS_IT_ALL = {
    'Path', 'BinaryIO', 'TextIO', 'Generator', 'Console', 'TracebackType', 'Attachment', 'Channel',
    'ChunkIndex', 'Metadata', 'Schema', 'Summary'}
"""Types that need no description: a file, chance, a terminal, the records of MCAP."""

_HOOKS = re.compile(r'validator|\bclick\.|\bproperty\b|cached_property|\.setter|overload')
"""Decorators whose functions are called by a framework, or described in its own way."""

FUNCTION = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def parsed(path):
    return ast.parse(path.read_text(encoding='utf-8'))


def public_modules(room):
    for path in sorted([*(ROOT / room).rglob('*.py'), *ROOT.glob(f'{room}.py')]):
        parts = path.relative_to(ROOT).with_suffix('').parts
        if not any(part.startswith('_') and part != '__init__' for part in parts):
            yield path, parsed(path)


@cache
def classes_by_name():
    found = {}
    for room in ROOMS:
        for _, tree in public_modules(room):
            found |= {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    return found


def names_in(annotation):
    """All identifiers of an annotation, those within quotes too."""
    return set(re.findall(r'\w+', ast.unparse(annotation))) if annotation else set()


def inherits(method, cls):
    """Whether a class above defines the method and says what it does."""
    for base in cls.bases:
        above = classes_by_name().get(re.split(r'[.\[]', ast.unparse(base))[-1])
        if above is None or above is cls:
            continue
        own = {node.name: node for node in above.body if isinstance(node, FUNCTION)}
        if (method in own and ast.get_docstring(own[method])) or inherits(method, above):
            return True
    return False


def described(name, docstring):
    words = name.strip('_').replace('_', '[ _]').removesuffix('s')
    return re.search(rf'\b{words}s?\b', docstring, re.IGNORECASE) is not None


def undescribed(function, docstring):
    """The parameters of a function that neither a docstring nor their type describes."""
    given = function.args
    for one in (*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg):
        if one is None or one.arg in ('self', 'cls') or one.arg.startswith('_'):
            continue
        types = names_in(one.annotation)
        known = types & classes_by_name().keys()
        ours = any(ast.get_docstring(classes_by_name()[name]) for name in known)
        if not ours and not types & _SAYS_IT_ALL and not described(one.arg, docstring):
            yield one.arg


def parameters(function):
    """The names of the parameters that callers give."""
    given = function.args
    every = (*given.posonlyargs, *given.args, given.vararg, *given.kwonlyargs, given.kwarg)
    return {one.arg for one in every if one is not None and not one.arg.startswith('_')} - {
        'self', 'cls'}


@cache
def sections(docstring):
    """The sections of a docstring as numpydoc reads them."""
    return NumpyDocString(docstring)


def listed(docstring):
    """The names of the parameters that a docstring lists; `*names` without their stars."""
    found = sections(docstring)
    return {name.strip(' *') for entry in found['Parameters'] + found['Other Parameters']
            for name in entry.name.split(',')}


def incomplete(function, docstring):
    """What is missing in the sections of a function's docstring."""
    for name in sorted(parameters(function) - listed(docstring)):
        yield f'lacks `{name}` in its Parameters section'
    returned = ast.unparse(function.returns) if function.returns else 'None'
    found = sections(docstring)
    if returned not in ('None', 'NoReturn', 'Never') and not (found['Returns'] or found['Yields']):
        yield 'lacks a Returns section'


def is_dataclass(cls):
    return any('dataclass' in ast.unparse(d) for d in cls.decorator_list) or any(
        'NamedTuple' in ast.unparse(b) for b in cls.bases)


def undescribed_fields(cls, docstring):
    """Public fields of a dataclass without a word in the docstring or a string below them."""
    for node, after in zip(cls.body, [*cls.body[1:], None], strict=True):
        if not isinstance(node, ast.AnnAssign) or 'ClassVar' in ast.unparse(node.annotation):
            continue
        name = node.target.id
        below = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
        declared = isinstance(node.value, ast.Call)  # a setting or a parameter, with its meaning
        ours = names_in(node.annotation) & classes_by_name().keys()
        if not (name.startswith('_') or below or declared or ours or described(name, docstring)):
            yield name


def public_names(path, tree):
    """(label, node, class) of all public functions, classes and methods of one module.

    Without those that a framework calls, such as the commands of click.
    """
    for node in tree.body:
        if getattr(node, 'name', '_').startswith('_'):
            continue
        label = f'{path.relative_to(ROOT)}: {node.name}'
        yield label, node, None
        for method in node.body if isinstance(node, ast.ClassDef) else ():
            if isinstance(method, FUNCTION) and not method.name.startswith('_'):
                yield f'{label}.{method.name}', method, node


def hooked(function):
    return any(_HOOKS.search(ast.unparse(d)) for d in function.decorator_list)


def complaints(path, tree):
    """(where, what is wrong) of one module."""
    if not ast.get_docstring(tree) and tree.body:
        yield str(path.relative_to(ROOT)), 'has no docstring'
    for label, node, cls in public_names(path, tree):
        found = of_class(node) if isinstance(node, ast.ClassDef) else of_function(node, cls)
        yield from ((label, what) for what in found)


def of_function(function, cls=None):
    """What is wrong with the docstring of a function, or of a method of a class."""
    own = ast.get_docstring(function) or ''
    inherited = cls is not None and inherits(function.name, cls)
    if hooked(function) or not own:
        if not own and not inherited and not hooked(function):
            yield 'has no docstring'
        return
    for name in sorted(listed(own) - parameters(function)):
        yield f'has no parameter `{name}` of its Parameters section'
    if not inherited:
        yield from incomplete(function, own)
    above = ast.get_docstring(cls) or '' if cls is not None else ''
    for name in undescribed(function, f'{own} {above}'):
        yield f'does not describe `{name}`'


def of_class(cls):
    """What is wrong with the docstring of a class; its `__init__` may list the parameters."""
    whole = ast.get_docstring(cls) or ''
    if not whole:
        yield 'has no docstring'
        return
    if is_dataclass(cls):
        for name in undescribed_fields(cls, whole):
            yield f'does not describe `{name}`'
    for made in (m for m in cls.body if isinstance(m, FUNCTION) and m.name == '__init__'):
        own = ast.get_docstring(made) or ''
        names = listed(own) if listed(own) else listed(whole)
        for name in sorted(names - parameters(made)):
            yield f'has no parameter `{name}` of its Parameters section'
        for name in sorted(parameters(made) - names):
            yield f'lacks `{name}` in its Parameters section'
        for name in undescribed(made, f'{whole} {own}'):
            yield f'does not describe `{name}`'


def unexplained(text):
    """Names of the numbers of a module or its classes without a string below or a comment."""
    lines = text.splitlines()

    def within(body):
        for node, after in pairwise([*body, None]):
            if isinstance(node, ast.ClassDef):
                yield from within(node.body)
            if not (isinstance(node, ast.Assign | ast.AnnAssign) and node.value):
                continue
            number = any(isinstance(one, ast.Constant) and type(one.value) in (int, float)
                         for one in ast.walk(node.value))
            below = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            target = node.targets[0] if isinstance(node, ast.Assign) else node.target
            name = ast.unparse(target).split(',')[0].strip('(')
            beside = '#' in lines[node.end_lineno - 1] or '#' in lines[node.lineno - 2][:5]
            if re.fullmatch(r'[A-Z_]*[A-Z][A-Z0-9_]+', name) and number and not (below or beside):
                yield name

    return within(ast.parse(text).body)


# Imports ----------------------------------------------------------------------------------------

FILES = {
    '.'.join(('microbot_ros', *path.relative_to(ROOT).with_suffix('').parts))
    .removesuffix('.__init__'): path for path in sorted(ROOT.rglob('*.py'))}


def at_import(nodes):
    """Import statements that run when the file does: not in functions, nor for type checkers."""
    for node in nodes:
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield node
        elif isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.unparse(node.test):
            yield from at_import(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from at_import(ast.iter_child_nodes(node))


def needs(name):
    """The files of the package that a file names in its imports, by module name."""
    tree = parsed(FILES[name])
    for node in at_import(tree.body):
        if getattr(node, 'level', 0):
            raise ValueError(f'{name}: relative import in line {node.lineno}')
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in FILES)
        elif node.module in FILES:
            inside = {f'{node.module}.{alias.name}' for alias in node.names}
            yield from inside & FILES.keys()
            if inside - FILES.keys():
                yield node.module


def circle(graph):
    """The names along one circle of {name: names}; none where there is no circle."""
    done = set()

    def visit(name, path):
        if name in path:
            return [*path[path.index(name):], name]
        if name in done:
            return []
        found = next(filter(None, (visit(other, [*path, name]) for other in graph[name])), [])
        done.add(name)
        return found

    return next(filter(None, (visit(name, []) for name in graph)), [])


def unshared():
    """Files that import numba at once, not by `compiled.load`, or without the cache of ours."""
    for name in FILES.keys() - {'microbot_ros.common.compiled.cache'}:
        text = FILES[name].read_text(encoding='utf-8')
        for node in ast.walk(ast.parse(text)) if 'numba' in text else ():
            if isinstance(node, ast.Import):
                wrong = 'numba' in {alias.name for alias in node.names}
            else:
                wrong = isinstance(node, ast.ImportFrom) and node.module == 'numba'
            if wrong:
                yield name


def unplaced():
    """Files with a legend that matplotlib is to place."""
    for name, path in FILES.items():
        text = path.read_text(encoding='utf-8')
        for node in ast.walk(ast.parse(text)) if '.legend(' in text else ():
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith('.legend'):
                places = [word.value.value for word in node.keywords if word.arg == 'loc']
                if places in ([], ['best']):
                    yield f'{name}:{node.lineno}'


def main():
    """Print all complaints, and how many names are complete; 1 if there are complaints."""
    modules = [module for room in ROOMS for module in public_modules(room)]
    names = {label for module in modules for label, _, _ in public_names(*module)}
    wrong = [one for module in modules for one in complaints(*module)]
    wrong += [(f'{path.relative_to(ROOT)}: {name}', 'does not say where its value is from')
              for path, _ in modules for name in unexplained(path.read_text(encoding='utf-8'))]
    found = [f'{where} {what}' for where, what in wrong]
    if around := circle({name: sorted({*needs(name)} - {name}) for name in FILES}):
        found.append(f'imports run in a circle: {" → ".join(around)}')
    found += [f'{name}: import numba from microbot_ros.common.compiled' for name in unshared()]
    found += [f'{where}: expected a legend with loc, other than best' for where in unplaced()]
    for complaint in found:
        print(complaint)
    complete = len(names - {where for where, _ in wrong})
    print(f'{complete} of {len(names)} public names have complete docstrings')
    return 1 if found else 0


if __name__ == '__main__':
    gc.disable()  # Trees have no garbage; looking for it takes two thirds of the time.
    sys.exit(main())
