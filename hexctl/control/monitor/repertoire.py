"""The repertoire of a robot: how it walked without some legs or joints, with each of a few gaits, by simulation.

Which legs failed, how, and the direction of travel are a situation; symmetric robots have walked one of several
that are alike. In each a few candidates walked in the same worlds: the gait that stands safest comes first, and
another is better where it was faster by more than the noise of the worlds, and fell no more often.
"""

import hashlib
import io
import json
import math
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.plan import TrialPlan
from hexctl.errors import HexctlError, InputError, check_type
from hexctl.files import atomic_write
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import NAMED_SLOTS, SWING_SHARE, Gait
from hexctl.gait.posture import STANCE, Posture
from hexctl.robot.configs import config_root
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray

FORMAT, VERSION = "hexctl repertoire", 1

SUFFIX = ".npz"

#: Folder of the repertoires that were built, in the folder of sessions and recordings, and of shipped ones.
REPERTOIRES = "repertoires"

#: A repertoire is for gaits whose pace, amplitude and height are within this share of its own.
NEAR = 0.15

#: Another candidate is better than the safest by at least this share of the commanded speed, and by this many
#: standard errors of the difference over the worlds.
LEAST_GAIN, ERRORS = 0.02, 2.0

#: The names of two candidates: the gait that stands safest, and the one of the intact robot.
SAFEST, WALK_ON = "safest", "walk-on"

#: A walk goes along a line that is held: in open loop gaits differ in where they lead.
HOLDS = ("auto", "line", "heading")


class RepertoireFileError(HexctlError, OSError):
    """A repertoire cannot be written."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BodySymmetry:
    """A turn or a mirroring of the body that puts every leg where there was one.

    Attributes:
        legs: leg `legs[k - 1]` is where leg k comes to lie.
        mirrored: whether left and right change places.
        turn_deg: by how much the body is turned, after the mirroring.
    """

    legs: tuple[int, ...]
    mirrored: bool
    turn_deg: float

    def heading_deg(self, heading_deg: float) -> float:
        """Where a direction of travel comes to lie, -180 up to 180."""
        return math.remainder(self.turn_deg + (-heading_deg if self.mirrored else heading_deg), 360.0)

    def failures(self, failures: Iterable[Failure]) -> "FailedParts":
        """Where failed legs and joints come to lie."""
        return parts_of(failures, self.legs)


#: Leg, kind and joint of each failure, by leg.
FailedParts = tuple[tuple[int, str, str | None], ...]

#: The body as it is.
IDENTITY = BodySymmetry(legs=tuple(range(1, N_LEGS + 1)), mirrored=False, turn_deg=0.0)


def parts_of(failures: Iterable[Failure], legs: Sequence[int] = IDENTITY.legs) -> FailedParts:
    """Leg, kind and joint of failures, by leg; `legs` are where the legs come to lie."""
    return tuple(sorted((legs[one.leg - 1], one.kind, one.joint) for one in failures))


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class Candidate:
    """A gait and a posture, without pace and strokes.

    Attributes:
        name: what it is; `safest` for the gait that stands safest, `walk-on` for that of the intact robot.
        slots: as those of a `Gait`.
        swing_share: likewise.
        phases: likewise.
        body_raise: as that of a `Posture`.
        shift: likewise.
        tucked_legs: likewise.
    """

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
        posture = gait.posture
        return cls(
            name=name,
            slots=gait.slots,
            swing_share=gait.swing_share,
            phases=gait.phases,
            body_raise=posture.body_raise,
            shift=posture.shift,
            tucked_legs=posture.tucked_legs,
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "Candidate":
        """Candidate of JSON values."""
        lists = ("slots", "phases", "shift", "tucked_legs")
        return cls(**{k: tuple(v) if k in lists and v is not None else v for k, v in values.items()})

    def gait(self, base: Gait) -> Gait:
        """The gait with pace, amplitude and height of another."""
        posture = Posture(body_raise=self.body_raise, shift=self.shift, tucked_legs=self.tucked_legs)
        return Gait(
            slots=self.slots,
            pace_hz=base.pace_hz,
            amplitude=base.amplitude,
            height=base.height,
            posture=posture,
            swing_share=self.swing_share,
            phases=self.phases,
        )

    def before(self, symmetry: BodySymmetry) -> "Candidate":
        """The candidate that a symmetry moves to this one."""
        angle_rad, (forward, left) = -math.radians(symmetry.turn_deg), self.shift
        ahead = math.cos(angle_rad) * forward - math.sin(angle_rad) * left
        aside = math.sin(angle_rad) * forward + math.cos(angle_rad) * left
        shift = (round(ahead, 6) + 0.0, round(-aside if symmetry.mirrored else aside, 6) + 0.0)
        leads = None if self.phases is None else tuple(self.phases[leg - 1] for leg in symmetry.legs)
        return Candidate(
            name=self.name,
            slots=tuple(self.slots[leg - 1] for leg in symmetry.legs),
            swing_share=self.swing_share,
            phases=leads,
            body_raise=self.body_raise,
            shift=shift,
            tucked_legs=tuple(leg for leg in IDENTITY.legs if symmetry.legs[leg - 1] in self.tucked_legs),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Situation:
    """How candidates walked with some legs or joints failed in one direction of travel.

    Attributes:
        failed: leg, kind and joint of each failure, by leg.
        heading_deg: direction of travel in the body frame.
        candidates: the safest gait first.
        speeds: along the line, as a share of what was commanded before the failure, (candidates, walks); NaN
            for a walk that did not end on its feet. Walks of one column differ in the candidate only.
        costs: of transport, likewise, NaN where it has none.
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
        """Share of walks that ended on their feet, (candidates,)."""
        return np.asarray(np.isfinite(self.speeds).mean(axis=1))

    @property
    def mean_speeds(self) -> FloatArray:
        """Mean speed of each candidate, walks that fell counted as 0, (candidates,)."""
        return np.asarray(np.nan_to_num(self.speeds, nan=0.0).mean(axis=1))

    @cached_property
    def best(self) -> int:
        """Index of the best candidate: the safest, unless another is faster beyond the noise.

        That is one whose walks ended on their feet as often, and whose mean gain over the safest in the same
        walks, less `ERRORS` standard errors, is the largest and above `LEAST_GAIN`.
        """
        speeds = np.nan_to_num(self.speeds, nan=0.0)
        gains = speeds - speeds[0]
        if self.walks < 2:
            return 0
        errors = gains.std(axis=1, ddof=1) / math.sqrt(self.walks)
        sure = gains.mean(axis=1) - ERRORS * errors
        falls_more = self.valid < self.valid[0]
        sure[falls_more | (np.arange(len(sure)) == 0)] = -math.inf
        first = int(np.argmax(sure))
        return first if sure[first] > LEAST_GAIN else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """What a repertoire has for a situation.

    Attributes:
        candidate: the best.
        gain: by how much it is faster than the safest gait, as a share of the commanded speed.
        walks: how many walks say so, of either.
    """

    candidate: Candidate
    gain: float
    walks: int


@dataclass(frozen=True, kw_only=True, eq=False)
class Repertoire:
    """How one robot walked with gaits of some pace and strokes after each of some failures.

    Attributes:
        robot: its name.
        robot_fingerprint: of its description.
        pace_hz: of the gaits.
        amplitude: of the gaits.
        height: of the gaits.
        direction_step_deg: between directions of travel.
        symmetries: of the robot, the identity first; of situations that are alike one was walked.
        situations: that were walked.
        origin: where it comes from, for people: families of worlds, numbers, versions.
    """

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
        """Whether it says something about the walks of a plan.

        That is of its robot, along a line that is held, with about its pace and strokes, in the posture of
        the stance, begun on six good legs.
        """
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
        """The best for some failures and a direction of travel in the body frame; None where none was walked.

        The direction is the nearest that was walked, by half a step off at most.
        """
        failures, heading_deg = tuple(failures), math.degrees(heading_rad)
        for symmetry in self.symmetries:
            moved_deg = symmetry.heading_deg(heading_deg)
            for situation in self._by_failure.get(symmetry.failures(failures), ()):
                off_deg = math.remainder(situation.heading_deg - moved_deg, 360.0)
                if abs(off_deg) <= self.direction_step_deg / 2 + 1e-6:
                    return _choice(situation, symmetry)
        return None

    @cached_property
    def _by_failure(self) -> dict[FailedParts, list[Situation]]:
        found: dict[FailedParts, list[Situation]] = {}
        for situation in self.situations:
            found.setdefault(situation.failed, []).append(situation)
        return found

    @property
    def head(self) -> dict[str, Any]:
        """Everything but the arrays, as JSON values; `walks` of each situation is how many each candidate has."""
        return {
            "robot": self.robot,
            "robot_fingerprint": self.robot_fingerprint,
            "pace_hz": self.pace_hz,
            "amplitude": self.amplitude,
            "height": self.height,
            "direction_step_deg": self.direction_step_deg,
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
        """Speeds or costs of all situations, one after the other, as they are stored."""
        values = [getattr(one, name).ravel() for one in self.situations]
        return np.concatenate(values).astype(np.float32) if values else np.zeros(0, np.float32)

    @property
    def arrays(self) -> dict[str, FloatArray]:
        """Its arrays as they are stored, by name."""
        return {"speeds": self._column("speeds"), "costs": self._column("costs")}

    def digest(self) -> str:
        """Hash of the whole content."""
        digest = hashlib.sha256(json.dumps(self.head, sort_keys=True).encode())
        for array in self.arrays.values():
            digest.update(array.tobytes())
        return digest.hexdigest()[:32]


def _choice(situation: Situation, symmetry: BodySymmetry) -> Choice:
    best, speeds = situation.best, situation.mean_speeds
    candidate = situation.candidates[best]
    return Choice(
        # Any shift in time of the tripod is the tripod.
        candidate=candidate if candidate.name == WALK_ON else candidate.before(symmetry),
        gain=float(speeds[best] - speeds[0]),
        walks=situation.walks,
    )


def is_shifted(one: Slots, other: Slots) -> bool:
    """Whether two gaits are the same but for the time at which they begin."""
    differences = {(a - b) % N_LEGS for a, b in zip(one, other, strict=True)}
    return len(differences) == 1


def save_repertoire(repertoire: Repertoire, path: Path) -> None:
    """Write a repertoire; the file is the old one or the new one at any moment.

    Raises RepertoireFileError when the disk refuses.
    """
    head = {"format": FORMAT, "version": VERSION, "digest": repertoire.digest(), **repertoire.head}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, head=np.array(json.dumps(head)), **repertoire.arrays)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, buffer.getvalue())
    except OSError as error:
        raise RepertoireFileError(f"repertoire: {path} cannot be written: {error.strerror}") from error


_DAMAGE = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
    RuntimeError,  # zipfile, of a file that claims to be encrypted
)


def load_repertoire(path: Path | str) -> Repertoire:
    """Repertoire of a file.

    Raises InputError for a file that is not one, is of another version, is cut off or was altered.
    """
    check_type(path, (str, Path), "repertoire", "the path of a file")
    try:
        with np.load(path, allow_pickle=False) as file:
            head = json.loads(str(file["head"]))
            arrays = {name: file[name].astype(float) for name in ("speeds", "costs") if name in file.files}
    except FileNotFoundError:
        raise InputError(
            f"repertoire: no file at {str(path)!r}; allowed: a file of hexctl prior build --repertoire"
        ) from None
    except _DAMAGE as error:
        raise _refused(path, "it is not a repertoire, or cut off") from error
    if not isinstance(head, dict) or head.get("format") != FORMAT:
        raise _refused(path, "it is not a repertoire")
    if head.get("version") != VERSION:
        raise _refused(path, f"it has version {head.get('version')}, this hexctl reads {VERSION}")
    try:
        repertoire = _made(head, arrays)
        intact = repertoire.digest() == head["digest"]
    except _DAMAGE as error:
        raise _refused(path, f"it is damaged ({' '.join(str(error).split())[:120]})") from error
    if not intact:
        raise _refused(path, "it was altered after it was built")
    return repertoire


def _made(head: dict[str, Any], arrays: dict[str, FloatArray]) -> Repertoire:
    """Repertoire of what its file holds."""
    situations, first = [], 0
    for values in head["situations"]:
        candidates = tuple(Candidate.from_dict(one) for one in values["candidates"])
        shape = len(candidates), int(values["walks"])
        last = first + shape[0] * shape[1]
        situations.append(
            Situation(
                failed=tuple((leg, kind, joint) for leg, kind, joint in values["failed"]),
                heading_deg=values["heading_deg"],
                candidates=candidates,
                speeds=arrays["speeds"][first:last].reshape(shape),
                costs=arrays["costs"][first:last].reshape(shape),
            )
        )
        first = last
    names = ("robot", "robot_fingerprint", "pace_hz", "amplitude", "height", "direction_step_deg", "origin")
    symmetries = [BodySymmetry(**one | {"legs": tuple(one["legs"])}) for one in head["symmetries"]]
    return Repertoire(
        **{name: head[name] for name in names}, symmetries=tuple(symmetries), situations=tuple(situations)
    )


def _refused(path: Path | str, why: str) -> InputError:
    return InputError(
        f"repertoire {path}: {why}; allowed: a repertoire as hexctl prior build --repertoire writes it"
    )


def repertoire_files(folder: Path | str = "runs") -> list[Path]:
    """Files that may be repertoires, in the order in which they are searched: built ones, then shipped ones."""
    folders = [Path(folder) / REPERTOIRES, config_root() / REPERTOIRES]
    return [path for one in folders if one.is_dir() for path in sorted(one.glob(f"*{SUFFIX}"))]


def find_repertoire(robot: Robot, plan: TrialPlan, folder: Path | str = "runs") -> Repertoire | None:
    """The first repertoire that says something about the walks of a plan; None without one.

    Files that cannot be read are passed over.
    """
    for path in repertoire_files(folder):
        try:
            found = load_repertoire(path)
        except InputError:
            continue
        if found.covers(robot, plan):
            return found
    return None


#: What `WALK_ON` has walked.
INTACT_GAIT = "tripod"


def walks_on(candidate: Candidate, gait: Gait) -> bool:
    """Whether a candidate is the gait that the intact robot of a plan walks."""
    return candidate.name == WALK_ON and is_shifted(NAMED_SLOTS[INTACT_GAIT], gait.slots)
