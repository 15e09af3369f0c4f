"""The repertoire of a robot: simulated walks after failures.

A situation is a set of failures and a direction of travel; of symmetric ones only one is simulated. A few
candidate gaits walk in the same worlds. One is better than the most stable gait if it is faster beyond the
noise of the worlds, and falls no more often. Repertoires are custom files, or shipped.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from hexctl.archive import ArchiveKind, content_digest
from hexctl.control.body_symmetry import IDENTITY, BodySymmetry
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.files import OnDamage, log_damage
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS, SWING_SHARE, Gait
from hexctl.gait.posture import STANCE, Posture
from hexctl.robot.configs import config_root
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray

VERSION = 1

KIND = ArchiveKind(name="repertoire", versions=(VERSION,), command="hexctl prior build --repertoire")

SUFFIX = ".npz"

#: Folder of custom repertoires in the folder of sessions, and of shipped ones.
REPERTOIRES = "repertoires"

#: A repertoire covers gaits with pace, amplitude and height within this share of those of its robot.
NEAR = 0.15

#: Minimum gain of a better candidate, as a share of the commanded speed, and in standard errors.
LEAST_GAIN, ERRORS = 0.02, 2.0

#: Names of two candidates: the most stable gait, and that of the intact robot.
SAFEST, WALK_ON = "safest", "walk-on"

#: Walks are along a held line: in open loop gaits differ in their direction.
HOLDS = ("auto", "line", "heading")


#: Leg, kind and joint of each failure, by leg.
FailedParts = tuple[tuple[int, str, str | None], ...]


def parts_of(failures: Iterable[Failure]) -> FailedParts:
    """Leg, kind and joint of failures, by leg."""
    return tuple(sorted((one.leg, one.kind, one.joint) for one in failures))


def moved_parts(parts: FailedParts, legs: Sequence[int]) -> FailedParts:
    """Failed parts after the legs have been mapped to others."""
    return tuple(sorted((legs[leg - 1], kind, joint) for leg, kind, joint in parts))


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Candidate:
    """A gait and a posture without pace and strokes; named `safest`, `walk-on` or by its search."""

    name: str
    slots: Slots
    swing_share: float = SWING_SHARE
    phases: tuple[float, ...] | None = None
    body_raise: float = 0.0
    shift: tuple[float, float] = (0.0, 0.0)
    tucked_legs: tuple[int, ...] = ()

    @classmethod
    def of(cls, name: str, gait: Gait) -> "Candidate":
        """Candidate of a gait."""
        shape = {part: getattr(gait, part) for part in ("slots", "swing_share", "phases")}
        return cls(name=name, **shape, **asdict(gait.posture))

    def gait(self, base: Gait) -> Gait:
        """The gait with pace, amplitude and height of another."""
        posture = Posture(body_raise=self.body_raise, shift=self.shift, tucked_legs=self.tucked_legs)
        return replace(
            base, slots=self.slots, posture=posture, swing_share=self.swing_share, phases=self.phases
        )

    def before(self, symmetry: BodySymmetry) -> "Candidate":
        """The candidate that a symmetry maps to this one."""
        angle_rad, (forward, left) = -math.radians(symmetry.turn_deg), self.shift
        ahead = math.cos(angle_rad) * forward - math.sin(angle_rad) * left
        aside = math.sin(angle_rad) * forward + math.cos(angle_rad) * left
        shift = (round(ahead, 6) + 0.0, round(-aside if symmetry.mirrored else aside, 6) + 0.0)
        leads = None if self.phases is None else tuple(self.phases[leg - 1] for leg in symmetry.legs)
        return replace(
            self,
            slots=tuple(self.slots[leg - 1] for leg in symmetry.legs),
            phases=leads,
            shift=shift,
            tucked_legs=tuple(leg for leg in IDENTITY.legs if symmetry.legs[leg - 1] in self.tucked_legs),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Situation:
    """Walks of candidates with some failures in one direction of travel.

    Attributes:
        candidates: the most stable gait first.
        speeds: along the line, as a share of the commanded speed, (candidates, worlds); NaN for a fall.
        costs: of transport, (candidates, worlds); NaN if unknown.
    """

    failed: FailedParts
    heading_deg: float
    candidates: tuple[Candidate, ...]
    speeds: FloatArray
    costs: FloatArray

    def __post_init__(self) -> None:
        for name in ("speeds", "costs"):
            shape = getattr(self, name).shape
            if len(shape) != 2 or shape[0] != len(self.candidates) or not shape[1]:
                raise ValueError(f"{name} has shape {shape}, expected ({len(self.candidates)}, walks)")

    @property
    def walks(self) -> int:
        """Number of walks of each candidate."""
        return int(self.speeds.shape[1])

    @property
    def valid(self) -> FloatArray:
        """Share of walks without a fall, (candidates,)."""
        return np.asarray(np.isfinite(self.speeds).mean(axis=1))

    @property
    def mean_speeds(self) -> FloatArray:
        """Mean speed of each candidate, falls counted as 0, (candidates,)."""
        return np.asarray(np.nan_to_num(self.speeds, nan=0.0).mean(axis=1))

    @property
    def gains(self) -> FloatArray:
        """Speed of each candidate above that of the first in each world, (candidates, walks)."""
        speeds = np.nan_to_num(self.speeds, nan=0.0)
        return np.asarray(speeds - speeds[0])

    @property
    def kinds(self) -> tuple[object, ...]:
        """Key of situations with a common estimate: kind and joint; each pair has its own."""
        if len(self.failed) > 1:
            return self.failed, self.heading_deg
        return (*((kind, joint) for _, kind, joint in self.failed), self.walks)


def sure_gains(gains: FloatArray) -> FloatArray:
    """Confident gain in each situation, of gains over the first candidate, (situations, worlds).

    It is the mean less `ERRORS` standard errors, the mean of each situation shrunk towards that of all by the
    noise share v / (v + t) of its variance: v is the variance within situations over the number of worlds, t
    that of the situations' means beyond v (empirical Bayes, normal). A single situation keeps its mean.
    """
    count, worlds = gains.shape
    if worlds < 2:
        return np.full(count, -math.inf)
    means = gains.mean(axis=1)
    within = float(gains.var(axis=1, ddof=1).mean()) / worlds
    shared = float(gains.mean(axis=0).var(ddof=1)) / worlds
    if count == 1:
        return np.asarray(means - ERRORS * math.sqrt(shared))
    between = max(0.0, float(means.var(ddof=1)) - within)
    own = between / (between + within) if between + within > 0 else 0.0
    shared = max(shared, (between + within) / count)
    error = math.sqrt(own * within + (1 - own) ** 2 * shared)
    return np.asarray(means.mean() + own * (means - means.mean()) - ERRORS * error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """The best candidate for a situation; its gain is a share of the commanded speed."""

    candidate: Candidate
    gain: float
    walks: int


#: Fields of a repertoire stored unchanged, before its symmetries and situations.
PLAIN = ("robot", "robot_fingerprint", "pace_hz", "amplitude", "height", "direction_step_deg")


@dataclass(frozen=True, kw_only=True, eq=False)
class Repertoire:
    """Walks of one robot after each of some failures; the first symmetry is the identity."""

    robot: str
    robot_fingerprint: str
    pace_hz: float
    amplitude: float
    height: float
    direction_step_deg: float
    symmetries: tuple[BodySymmetry, ...]
    situations: tuple[Situation, ...]
    origin: dict[str, Any]

    def covers(self, robot: Robot, plan: TrialPlan) -> bool:
        """Whether it applies: robot, held line, similar pace and strokes, stance posture, intact legs."""
        gait = plan.gait
        own, asked = (self.pace_hz, self.amplitude, self.height), (gait.pace_hz, gait.amplitude, gait.height)
        return (
            self.robot_fingerprint == robot.fingerprint
            and plan.straight
            and plan.hold in HOLDS
            and not plan.failures
            and gait.posture == STANCE
            and gait.swing_share == SWING_SHARE
            and all(abs(a - b) <= NEAR * b for a, b in zip(asked, own, strict=True))
        )

    def choice(self, failures: Iterable[Failure], heading_rad: float) -> Choice | None:
        """The best candidate for some failures and the nearest direction, or None."""
        return self._choices.get((self._direction(math.degrees(heading_rad)), parts_of(failures)))

    def _direction(self, heading_deg: float) -> int:
        return round(heading_deg / self.direction_step_deg) % round(360 / self.direction_step_deg)

    @cached_property
    def best(self) -> tuple[int, ...]:
        """Index of each situation's best candidate: the safest, or one with a sufficient `sure_gains`."""
        alike: dict[tuple[object, str], list[tuple[int, int]]] = {}
        for index, one in enumerate(self.situations):
            for row, candidate in enumerate(one.candidates):
                alike.setdefault((one.kinds, candidate.name), []).append((index, row))
        sure: dict[tuple[int, str], float] = {}
        for (_, name), rows in alike.items():
            gains = np.array([self.situations[index].gains[row] for index, row in rows])
            for (index, _), gain in zip(rows, sure_gains(gains).tolist(), strict=True):
                sure[index, name] = gain
        return tuple(_best_of(one, index, sure) for index, one in enumerate(self.situations))

    @cached_property
    def _choices(self) -> dict[tuple[int, FailedParts], Choice]:
        found: dict[tuple[int, FailedParts], Choice] = {}
        for symmetry in self.symmetries:
            for situation, best in zip(self.situations, self.best, strict=True):
                direction = self._direction(symmetry.heading_before_deg(situation.heading_deg))
                failed = moved_parts(situation.failed, symmetry.legs_before)
                found.setdefault((direction, failed), _choice(situation, best, symmetry))
        return found

    @property
    def head(self) -> dict[str, Any]:
        """Everything but the arrays, as JSON values; each candidate of a situation has its `walks`."""
        return {
            **{name: getattr(self, name) for name in PLAIN},
            "symmetries": [asdict(one) for one in self.symmetries],
            "situations": [
                {
                    "failed": [list(part) for part in one.failed],
                    "heading_deg": one.heading_deg,
                    "walks": one.walks,
                    "candidates": [asdict(candidate) for candidate in one.candidates],
                }
                for one in self.situations
            ],
            "origin": self.origin,
        }

    def _column(self, name: str) -> FloatArray:
        values = [getattr(one, name).ravel() for one in self.situations]
        return np.concatenate(values).astype(np.float32) if values else np.zeros(0, np.float32)

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """The stored arrays, by name."""
        return {"speeds": self._column("speeds"), "costs": self._column("costs")}

    @cached_property
    def digest(self) -> str:
        """Hash of the complete content."""
        return content_digest(self.head, self.arrays)


def _best_of(situation: Situation, index: int, sure: Mapping[tuple[int, str], float]) -> int:
    """Index of the best candidate of a situation, given the sure gains by its number and the names."""
    best, most, valid = 0, LEAST_GAIN, situation.valid
    for row, candidate in enumerate(situation.candidates[1:], 1):
        if sure[index, candidate.name] > most and valid[row] >= valid[0]:
            best, most = row, sure[index, candidate.name]
    return best


def _choice(situation: Situation, best: int, symmetry: BodySymmetry) -> Choice:
    speeds = situation.mean_speeds
    candidate = situation.candidates[best]
    return Choice(
        # Any shift in time of the tripod is the tripod.
        candidate=candidate if candidate.name == WALK_ON else candidate.before(symmetry),
        gain=float(speeds[best] - speeds[0]),
        walks=situation.walks,
    )


#: The gait of `WALK_ON`.
INTACT_GAIT = "tripod"


def walks_on(candidate: Candidate, gait: Gait) -> bool:
    """Whether a candidate is the gait that the intact robot of a plan walks, at any shift in time."""
    pairs = zip(NAMED_SLOTS[INTACT_GAIT], gait.slots, strict=True)
    return candidate.name == WALK_ON and len({(one - other) % N_LEGS for one, other in pairs}) == 1


def save_repertoire(repertoire: Repertoire, path: Path) -> None:
    """Write a repertoire atomically; raises ArchiveFileError when the disk refuses."""
    KIND.save(path, VERSION, repertoire.head, repertoire.arrays)


def load_repertoire(path: Path | str) -> Repertoire:
    """Repertoire of a file; raises InputError for a wrong, damaged or altered file, or another version."""
    return KIND.load(path, _made)


def _made(head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> Repertoire:
    candidates_of = TypeAdapter(tuple[Candidate, ...]).validate_python
    shapes = [(len(one["candidates"]), int(one["walks"])) for one in head["situations"]]
    ends = np.cumsum([candidates * walks for candidates, walks in shapes], dtype=int)[:-1]
    speeds, costs = (np.split(arrays[name].astype(float), ends) for name in ("speeds", "costs"))
    situations = [
        Situation(
            failed=tuple((leg, kind, joint) for leg, kind, joint in values["failed"]),
            heading_deg=values["heading_deg"],
            candidates=candidates_of(values["candidates"]),
            speeds=speed.reshape(shape),
            costs=cost.reshape(shape),
        )
        for values, shape, speed, cost in zip(head["situations"], shapes, speeds, costs, strict=False)
    ]
    symmetries = TypeAdapter(tuple[BodySymmetry, ...]).validate_python(head["symmetries"])
    plain = {name: head[name] for name in (*PLAIN, "origin")}
    return Repertoire(**plain, symmetries=symmetries, situations=tuple(situations))


def describe_repertoire(path: Path | str) -> dict[str, Any]:
    """Summary of a repertoire as JSON values; raises InputError as `load_repertoire` does."""
    found = load_repertoire(path)
    kinds = [(len(one.failed), *one.failed[0][1:]) for one in found.situations]
    words = {
        count: [f"{kind}:{joint}" if joint else kind for n, kind, joint in kinds if n == count]
        for count in (1, 2)
    }
    return {
        "robot": found.robot,
        "pace_hz": found.pace_hz,
        "amplitude": found.amplitude,
        "height": found.height,
        "legs": list(dict.fromkeys(words[1])),
        "pairs": list(dict.fromkeys(words[2])),
        "directions": round(360 / found.direction_step_deg),
        "situations": len(found.situations),
        "others": sum(best != 0 for best in found.best),
        "walks": min((one.walks for one in found.situations), default=0),
        "bytes": Path(path).stat().st_size,
    }


def repertoire_files(folder: Path | str = "runs") -> list[Path]:
    """Candidate files in the order of the search: custom ones, then shipped ones."""
    folders = [Path(folder) / REPERTOIRES, config_root() / REPERTOIRES]
    return [path for one in folders if one.is_dir() for path in sorted(one.glob(f"*{SUFFIX}"))]


def named_repertoire(text: str, folder: Path | str = "runs") -> Path:
    """Path of a repertoire: the path itself, or that of a file of this name among `repertoire_files`."""
    if Path(text).is_file():
        return Path(text)
    named = (path for path in repertoire_files(folder) if text in (path.name, path.stem))
    return next(named, Path(text))


def list_repertoires(
    folder: Path | str = "runs", *, on_damage: OnDamage = log_damage
) -> list[dict[str, Any]]:
    """Describe the repertoires of a walk's search, with paths as `repertoire`, without damaged ones."""
    return KIND.described(repertoire_files(folder), describe_repertoire, on_damage)


def find_repertoire(robot: Robot, plan: TrialPlan, folder: Path | str = "runs") -> Repertoire | None:
    """The first readable repertoire that covers the walks of a plan, or None."""
    for path in repertoire_files(folder):
        try:
            found = _loaded(path, path.stat().st_mtime_ns)
        except (InputError, OSError):
            continue
        if found.covers(robot, plan):
            return found
    return None


@lru_cache(maxsize=8)
def _loaded(path: Path, _modified_ns: int) -> Repertoire:
    return load_repertoire(path)
