"""YAML of configuration files: read within limits and without duplicate keys, edited with its comments."""

from collections.abc import Iterator, Mapping
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


#: A replacement in a text: begin, end and new text.
Edit = tuple[int, int, str]


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """Text of a mapping with other content; only a section whose values share anchors loses its comments.

    A text that is no mapping is replaced.
    """
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
    except yaml.YAMLError:
        root = None
    if not isinstance(root, yaml.MappingNode):
        return yaml_lines(values)
    edited = _edited(text, _edits(text, root, values))
    if _says(edited, values):
        return edited
    return _edited(text, _edits(text, root, values, deep=False))


def _says(text: str, values: Mapping[str, Any]) -> bool:
    try:
        return bool(yaml_content(text) == values)
    except ValueError:
        return False


def _edits(
    text: str, node: yaml.MappingNode, values: Mapping[Any, Any], *, deep: bool = True
) -> Iterator[Edit]:
    there = {_content(key): (key, value) for key, value in node.value}
    for name, (key, value) in there.items():
        new = values.get(name)
        if name not in values:
            yield key.start_mark.index, _end(text, value), ""
        elif _content(value) == new:
            continue
        elif deep and isinstance(value, yaml.MappingNode) and isinstance(new, Mapping) and new:
            yield from _edits(text, value, new)
        elif deep and isinstance(value, yaml.ScalarNode) and not isinstance(new, Mapping | list):
            yield value.start_mark.index, _end(text, value), _scalar(new)
        elif node.flow_style:
            yield key.start_mark.index, _end(text, value), _flow({name: new})
        else:
            lines = yaml_lines({name: new}).rstrip("\n").split("\n")
            yield key.start_mark.index, _end(text, value), f"\n{_indent(node)}".join(lines)
    if added := {name: value for name, value in values.items() if name not in there}:
        yield _added(text, node, added)


def _added(text: str, mapping: yaml.MappingNode, entries: dict[Any, Any]) -> Edit:
    if mapping.flow_style:
        at = mapping.end_mark.index - 1
        within = text[mapping.start_mark.index + 1 : at].rstrip()
        comma = ", " if mapping.value and not within.endswith(",") else ""
        return at, at, f"{comma}{_flow(entries)}"
    at = _end(text, mapping)
    indent = _indent(mapping)
    return at, at, "".join(f"\n{indent}{line}" for line in yaml_lines(entries).rstrip("\n").split("\n"))


def _end(text: str, node: yaml.Node) -> int:
    """End of a node; comments and blank lines before the next key belong to that key."""
    begin, end = node.start_mark.index, node.end_mark.index
    if not isinstance(node, yaml.CollectionNode) or node.flow_style:
        return int(end) - text[begin:end].endswith("\n")  # of a text over lines
    lines = text[begin:end].split("\n")
    while len(lines) > 1 and (not lines[-1].strip() or lines[-1].lstrip().startswith("#")):
        lines.pop()
    return int(begin) + len("\n".join(lines))


def _content(node: yaml.Node) -> Any:
    loader = yaml.SafeLoader("")
    return loader.construct_document(node)


def _indent(mapping: yaml.MappingNode) -> str:
    return " " * int(mapping.value[0][0].start_mark.column)


def _edited(text: str, edits: Iterator[Edit]) -> str:
    for begin, end, new in sorted(set(edits), reverse=True):
        text = text[:begin] + new + text[end:]
    return text if text.endswith("\n") else f"{text}\n"


class _Dumper(yaml.SafeDumper):
    """Writes shared values in full."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def yaml_lines(content: Mapping[Any, Any]) -> str:
    """Lines of a mapping: one for each key, and one for each part of a mapping or a list of mappings."""
    return "".join(line for key, value in content.items() for line in _lines(key, value))


def _lines(key: Any, value: Any) -> Iterator[str]:
    parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ()
    if not parts or not all(isinstance(part, Mapping) for part in parts):
        yield f"{_flow({key: value})}\n"
        return
    yield f"{_scalar(key)}:\n"
    if isinstance(value, Mapping):
        yield from (f"  {_flow({name: part})}\n" for name, part in value.items())
    else:
        yield from (f"- {{{_flow(part)}}}\n" for part in parts)


def _flow(content: Mapping[Any, Any]) -> str:
    return _dumped(dict(content), flow=True)[1:-2]


def _dumped(content: object, *, flow: bool | None) -> str:
    layout: Any = {"default_flow_style": flow, "width": 10_000, "sort_keys": False, "allow_unicode": True}
    return str(yaml.dump(content, Dumper=_Dumper, **layout))


def _scalar(value: object) -> str:
    """A value as YAML reads it back to the last bit: 1e-05 would be text there."""
    return _dumped(value, flow=None).split("\n")[0]
