"""The front of a robot by the names of its legs: `front_left`, `LF`, `l1`, `hind-right` ..."""

import math
import re
from collections.abc import Sequence

import numpy as np

from hexctl.types import N_LEGS, FloatArray

#: The robot's front in the frame of the root, and its axis there.
FORWARD = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0)}

#: Words of sides and ends, as names have them.
LEFT, RIGHT = ("left", "l"), ("right", "r")
FRONT, MIDDLE, REAR = (
    ("front", "fore", "f"),
    ("middle", "mid", "center", "centre", "m", "c"),
    ("rear", "back", "hind", "aft", "b", "h", "r"),
)

_SIDE = "|".join((*LEFT, *RIGHT))
_END = "|".join((*FRONT, *MIDDLE, *REAR))
_BOTH = (
    re.compile(rf"(?P<side>{_SIDE})(?P<end>{_END})?"),
    re.compile(rf"(?P<end>{_END})(?P<side>{_SIDE})"),
    re.compile(rf"(?!r$)(?P<end>{_END})"),
)
_WORD = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")

#: Cosine of the largest angle between the front by names and an axis of the root.
LEAST_ALONG = 0.8


def forward_by_names(names: Sequence[Sequence[str]], mounts_m: FloatArray, up: FloatArray) -> list[str]:
    """Keys of `FORWARD` by the names of legs: none if they show no front, two if ends and sides contradict.

    Args:
        names: of the joints and links of each leg.
        mounts_m: of the legs in the frame of the root, (6, 3).
        up: the vertical there, (3,).
    """
    places = np.array([_place(one) for one in names])
    sides, ends = places[:, 0], places[:, 1]
    shown = [ends @ mounts_m] if _even(ends, (-1, 0, 1)) else []
    shown += [np.cross(sides @ mounts_m, up)] if _even(sides, (-1, 1)) else []
    fronts = (_axis_along(one - (one @ up) * up) for one in shown)
    return list(dict.fromkeys(axis for axis in fronts if axis is not None))


def _axis_along(direction: FloatArray) -> str | None:
    length = float(np.linalg.norm(direction))
    return next((key for key, axis in FORWARD.items() if direction @ axis > LEAST_ALONG * length), None)


def _even(values: FloatArray, kinds: tuple[int, ...]) -> bool:
    """Whether as many legs have each of some values."""
    return all((values == kind).sum() == N_LEGS // len(kinds) for kind in kinds)


def _place(names: Sequence[str]) -> tuple[float, float]:
    """Side, 1 for left and -1 for right, and end, 1 for front and -1 for rear, of a leg; else NaN."""
    words = [word.lower() for name in names for word in _WORD.findall(name)]
    found = [match for word in words for one in _BOTH if (match := one.fullmatch(word))]
    sides = [(len(one[0]), 1.0 if one["side"] in LEFT else -1.0) for one in found if _has(one, "side")]
    ends = [(len(one[0]), _end(one["end"])) for one in found if _has(one, "end")]
    return _longest(sides), _longest(ends)


def _has(match: re.Match[str], group: str) -> bool:
    return match.groupdict().get(group) is not None


def _end(word: str) -> float:
    return 1.0 if word in FRONT else -1.0 if word in REAR else 0.0


def _longest(found: Sequence[tuple[int, float]]) -> float:
    """Value of the longest words, if they agree: single letters may stand for links."""
    values = {value for length, value in found if length == max(found)[0]}
    return values.pop() if len(values) == 1 else math.nan
