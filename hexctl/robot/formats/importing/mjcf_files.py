"""Limits of an MJCF and of the files that it includes: MuJoCo reads pipes and repeats without end."""

import html
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from hexctl.files import read_file
from hexctl.robot.formats.importing.link_tree import MOST_BYTES

#: Limits of a description: elements after all repetitions, files in one another, points of a height field,
#: and numbers that make a mesh.
MOST_ELEMENTS, MOST_DEPTH, MOST_POINTS, MOST_SIDES = 5_000, 8, 1_000_000, 100

#: Elements that make bodies of cloth, ropes and grains.
SOFT = ("composite", "flexcomp")

#: MuJoCo's XML is less strict than XML, therefore tags are found by their brackets, and comments, CDATA and
#: declarations between them. Each pattern reads a text once: it gives nothing back (`++`).
_TAG = re.compile(
    r"<!--(?:.*?-->|.*)|<!\[CDATA\[(?:.*?]]>|.*)|<\?(?:.*?\?>|.*)|<![^>]*"
    r"""|<\s*+(/?)([\w:.-]++)((?:"[^"]*"|'[^']*'|[^<>"'/]|/(?!>))*+)(/?)>""",
    re.DOTALL,
)
_ATTRIBUTE = re.compile(r"""(?<![\w:.-])([\w:.-]++)\s*+=\s*(?:"([^"]*)"|'([^']*)')""")


@dataclass(frozen=True, slots=True)
class _Tag:
    name: str
    values: dict[str, str]
    opens: bool
    closes: bool

    def number(self, key: str) -> float:
        """Size of a number, at least 1; 1 for anything else, which MuJoCo refuses."""
        try:
            value = float(self.values.get(key, ""))
        except ValueError:
            return 1.0
        if not math.isfinite(value):
            raise ValueError(f"has {key}={value} in a <{self.name}>")
        return max(1.0, abs(value))


def check_mjcf_files(path: Path) -> None:
    """Raise ValueError for an MJCF that asks for more than a robot needs, OSError for files that are none."""
    _Sizes(path.parent).of(path)


@dataclass(frozen=True, slots=True)
class _Sizes:
    """Numbers of elements of files, as parts that are repeated and files that are attached make them."""

    folder: Path
    _models: dict[str, float] = field(default_factory=dict)

    def of(self, path: Path, depth: int = 0) -> float:
        if depth > MOST_DEPTH:
            raise ValueError(f"has more than {MOST_DEPTH} files in one another")
        count, times = 0.0, [1.0]
        for tag in _tags(path):
            _check(tag)
            if tag.opens and not tag.closes:
                times.append(times[-1] * (tag.number("count") if tag.name == "replicate" else 1.0))
            if tag.closes and not tag.opens:
                times = times[:-1] or [1.0]
            count += times[-1] * (1.0 + self._more(tag, path, depth) if tag.opens else 0.0)
            if count > MOST_ELEMENTS:
                raise ValueError(f"makes more than {MOST_ELEMENTS} elements (<{tag.name}>)")
        return count

    def _more(self, tag: _Tag, path: Path, depth: int) -> float:
        """Number of elements of the file that a tag includes or attaches; one to be attached is none yet."""
        if tag.name == "attach":
            return self._models.get(tag.values.get("model", ""), sum(self._models.values()))
        if tag.name not in ("include", "model") or not (file := tag.values.get("file")):
            return 0.0
        places = dict.fromkeys(folder / file for folder in (self.folder, path.parent))
        count = sum(self.of(place, depth + 1) for place in places if place.exists())
        if tag.name == "include":
            return count
        self._models[tag.values.get("name", file)] = count
        return 0.0


def _check(tag: _Tag) -> None:
    if tag.name in SOFT:
        raise ValueError(f"has a <{tag.name}>, which is no part of a robot with servos")
    if tag.name == "hfield" and tag.number("nrow") * tag.number("ncol") > MOST_POINTS:
        raise ValueError(f"has a height field of more than {MOST_POINTS} points")
    if tag.name == "mesh" and any(
        float(one) > MOST_SIDES for one in re.findall(r"\d+", tag.values.get("params", ""))
    ):
        raise ValueError(f"has a built-in mesh with more than {MOST_SIDES} sides")


def _tags(path: Path) -> Iterator[_Tag]:
    for found in _TAG.finditer(read_file(path, MOST_BYTES).decode("utf-8", "replace")):
        slash, name, attributes, end = found.groups()
        if name is not None:
            pairs = _ATTRIBUTE.findall(attributes)
            values = {key: html.unescape(one or other) for key, one, other in pairs}
            yield _Tag(name, values, opens=not slash, closes=bool(slash or end))
