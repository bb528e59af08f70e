"""YAML as people write it: bounded size, depth, aliases and digits; no duplicate keys."""

from __future__ import annotations

import re
from typing import Any

import yaml

from microbot_ros.common.errors import clipped

LARGEST_BYTES = 2**24  # choice: 16 MiB, far more than people write
_DEEPEST = 40  # choice: levels, far more than any file of settings has
_MOST_NODES = 1_000_000  # choice: with all aliases expanded, harmless for memory
_LONGEST_NUMBER = 400  # choice: digits, more than any double needs
_WRONG_TAG = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
"""Errors of PyYAML for values such as `!!int x` or a date in month 13."""


class YamlError(ValueError):
    """Text that is not plain YAML: the `problem` as a phrase, and its `line` if known.

    Parameters
    ----------
    problem : str
        What is wrong, as a phrase.
    line : int or None
        Line from 1; None for unknown.
    """

    def __init__(self, problem: str, line: int | None = None) -> None:
        self.problem, self.line = problem, line
        super().__init__(problem)


class StrictLoader(yaml.SafeLoader):
    """Safe loader of PyYAML for a text `stream`, with limits on depth, aliases and digits.

    Duplicate keys in a mapping are errors, as in the standard.

    Parameters
    ----------
    stream : object
        The text.
    """

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._written_out: dict[str, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """Return the next node below `parent` at `index`, counting expanded aliases.

        Parameters
        ----------
        parent : yaml.Node or None
            Node above.
        index : object
            Place below the parent.

        Returns
        -------
        yaml.Node or None
            The node; None at the end.
        """
        event = self.peek_event()
        before, self._nodes = self._nodes, self._nodes + 1
        if isinstance(event, yaml.AliasEvent):
            name = str(event.anchor)
            if name in self.anchors and name not in self._written_out:
                _refuse(f"'*{clipped(name)}' refers to itself", event.start_mark)
            self._nodes += self._written_out.get(name, 0)
        self._depth += 1
        if self._depth > _DEEPEST:
            _refuse(f'expected at most {_DEEPEST} levels', event.start_mark)
        if self._nodes > _MOST_NODES:
            _refuse('expected fewer aliases', event.start_mark)
        node = super().compose_node(parent, index)
        self._depth -= 1
        if not isinstance(event, yaml.AliasEvent) and event.anchor is not None:
            self._written_out[event.anchor] = self._nodes - before
        return node

    def compose_scalar_node(self, anchor: Any) -> yaml.ScalarNode:
        """Return a scalar with an `anchor`, unless it is a number of too many digits.

        Parameters
        ----------
        anchor : object
            Anchor of the node; None for none.

        Returns
        -------
        yaml.ScalarNode
            The node.
        """
        node = super().compose_scalar_node(anchor)
        if node.tag.endswith((':int', ':float')) and len(node.value) > _LONGEST_NUMBER:
            _refuse(f'expected a number of at most {_LONGEST_NUMBER} digits', node.start_mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Return a mapping with an `anchor`, whose keys must all be different.

        Parameters
        ----------
        anchor : object
            Anchor of the node; None for none.

        Returns
        -------
        yaml.MappingNode
            The node.
        """
        node = super().compose_mapping_node(anchor)
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    _refuse(f"the key '{clipped(key.value)}' appears twice", key.start_mark)
                seen.add((key.tag, key.value))
        return node


# YAML 1.1, which PyYAML reads, takes `1e-3` and `1.5e3` for texts; YAML 1.2 and ROS do not.
StrictLoader.add_implicit_resolver(
    'tag:yaml.org,2002:float', re.compile(r'[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)[eE][-+]?[0-9]+\Z'),
    list('-+.0123456789'))


def load(text: str, loader: type[StrictLoader] = StrictLoader) -> tuple[yaml.Node | None, Any]:
    """Return the tree of the one document in `text`, and its content as built by `loader`.

    Raises YamlError if it is not YAML or exceeds the limits.

    Parameters
    ----------
    text : str
        The text.
    loader : type[StrictLoader]
        Class that builds the content.

    Returns
    -------
    tuple[yaml.Node or None, object]
        Root of the tree, None for an empty text, and the content.
    """
    if len(text) > LARGEST_BYTES:
        raise YamlError(f'at most {LARGEST_BYTES // 2**20} MB')
    try:
        reader = loader(text)
    except yaml.reader.ReaderError as error:
        raise YamlError(str(error.reason)) from None
    try:
        tree = reader.get_single_node()
        return tree, None if tree is None else reader.construct_document(tree)
    except yaml.YAMLError as error:
        mark = getattr(error, 'problem_mark', None)
        problem = getattr(error, 'problem', None) or getattr(error, 'reason', None)
        raise YamlError(clipped(str(problem or 'not YAML')), mark and mark.line + 1) from None
    except _WRONG_TAG:
        raise YamlError('a value does not match its tag or its form') from None
    finally:
        reader.dispose()


def _refuse(problem: str, mark: Any) -> None:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
