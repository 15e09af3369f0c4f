"""YAML of configuration files: plain, without duplicate keys, limited in size."""

from copy import deepcopy
from functools import lru_cache
from typing import Any

import yaml

from hexctl.errors import shown

#: Maximum number of nodes, aliases followed: nested merges of a few lines may stand for millions.
MOST_NODES = 100_000

#: Maximum length of a number: PyYAML computes numbers to base 60 and 16 of any length.
MOST_SIGNS = 50

_NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")


def yaml_content(text: str) -> Any:
    """The content of a YAML text; raises ValueError, also for duplicate keys and excessive size."""
    try:
        return deepcopy(_parsed(text))
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(_problem(error)) from error


@lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    """Parsed content of a text, cached: a robot file is read for the robot, its meshes and its name."""
    return yaml.load(text, Loader=_Loader)  # noqa: S506  a SafeLoader


class _Loader(yaml.SafeLoader):
    """Plain YAML: no application tags, no key twice."""

    def get_single_node(self) -> yaml.Node | None:
        node: yaml.Node | None = super().get_single_node()
        if node is not None:
            _check_size(node)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        """A value; PyYAML raises various errors for a scalar that does not match its tag."""
        if node.tag in _NUMBERS and len(str(node.value)) > MOST_SIGNS:
            raise _refused(f"got a number of {len(node.value)} signs; allowed: up to {MOST_SIGNS}", node)
        try:
            return super().construct_object(node, deep)
        except (ValueError, TypeError, LookupError, AttributeError, ArithmeticError) as error:
            kind = node.tag.rpartition(":")[2]
            raise _refused(f"got {shown(node.value)}, which is no {kind}", node) from error

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.value in seen:
                raise _refused(f"the key {shown(key.value)} is given twice", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _refused(problem: str, node: yaml.Node) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(problem=problem, problem_mark=node.start_mark)


def _check_size(root: yaml.Node) -> None:
    """Refuse a tree beyond `MOST_NODES` with all aliases followed, or one that contains itself."""
    sizes: dict[int, int] = {}

    def size(node: yaml.Node) -> int:
        if id(node) in sizes:
            if not sizes[id(node)]:
                raise _refused("it refers to itself", node)
            return sizes[id(node)]
        sizes[id(node)] = 0  # not known yet
        parts = node.value if isinstance(node, yaml.CollectionNode) else ()
        pairs = isinstance(node, yaml.MappingNode)
        total = 1 + sum(size(part) for each in parts for part in (each if pairs else (each,)))
        if total > MOST_NODES:
            raise _refused(f"it is larger than {MOST_NODES} values with its aliases followed", node)
        sizes[id(node)] = total
        return total

    size(root)


def _problem(error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    if isinstance(error, yaml.MarkedYAMLError) and mark is not None:
        return f"line {mark.line + 1}, column {mark.column + 1}: {error.problem}"
    return " ".join(str(error).split())
