"""YAML as people write it, and nothing else: no bombs, no towers, no key twice."""

from __future__ import annotations

from typing import Any

import yaml

from microbot_ros.common.errors import clipped

LARGEST_BYTES = 2**24
_DEEPEST = 40
_MOST_NODES = 1_000_000
"""Of a document with all its aliases written out."""
_LONGEST_NUMBER = 400
_WRONG_TAG = (ValueError, LookupError, TypeError, AttributeError, ArithmeticError)
"""What PyYAML raises for `!!int x`, or a date in month 13."""


class YamlError(ValueError):
    """A text is no plain YAML: the `problem` in one phrase, its `line` where there is one."""

    def __init__(self, problem: str, line: int | None = None) -> None:
        self.problem, self.line = problem, line
        super().__init__(problem)


class StrictLoader(yaml.SafeLoader):
    """PyYAML's safe loader within limits: of depth, of aliases written out, of digits.

    A key twice in one mapping is an error, as the standard has it. The `stream` is a text.
    """

    def __init__(self, stream: Any) -> None:
        super().__init__(stream)
        self._depth = self._nodes = 0
        self._written_out: dict[str, int] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        """The next node, below a `parent` at an `index`, counted as if it were written out."""
        event = self.peek_event()
        before, self._nodes = self._nodes, self._nodes + 1
        if isinstance(event, yaml.AliasEvent):
            name = str(event.anchor)
            if name in self.anchors and name not in self._written_out:
                _refuse(f"'*{clipped(name)}' stands within itself", event.start_mark)
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
        """A scalar with an `anchor`, unless it is a number of thousands of digits."""
        node = super().compose_scalar_node(anchor)
        if node.tag.endswith((':int', ':float')) and len(node.value) > _LONGEST_NUMBER:
            _refuse(f'expected a number of at most {_LONGEST_NUMBER} digits', node.start_mark)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """A mapping with an `anchor` whose keys are all different."""
        node = super().compose_mapping_node(anchor)
        seen: set[tuple[str, str]] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if (key.tag, key.value) in seen:
                    _refuse(f"the key '{clipped(key.value)}' stands there twice", key.start_mark)
                seen.add((key.tag, key.value))
        return node


def load(text: str, loader: type[StrictLoader] = StrictLoader) -> tuple[yaml.Node | None, Any]:
    """The tree of the one document in a `text`, and its content as a `loader` makes it.

    YamlError for what is no YAML, or more than a person writes.
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
        raise YamlError('a value is not what its tag or its form says') from None
    finally:
        reader.dispose()


def _refuse(problem: str, mark: Any) -> None:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
