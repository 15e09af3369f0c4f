"""Leg signatures: learned patterns by which a failed leg shows in the lean of the body and in the contacts.

They come from a file that `python -m benchmarks.build_signatures` writes. A pattern is in the frame of a leg:
its own gait cycle, lean toward its foot and across, its own contact and those of the next legs in turn. The
same patterns therefore serve all legs, gaits and robots.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.archive import ArchiveKind
from hexctl.control.monitor.phase_habit import PARTS
from hexctl.gait.gait import Gait
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray

VERSION = 1

KIND = ArchiveKind(name="signatures", versions=(VERSION,), command="python -m benchmarks.build_signatures")

#: Sensors of a failure: the lean ahead and to the left, or also the contact of each foot.
SENSORS = ("lean", "contacts")

ARRAYS = ("patterns", "sizes", "biases", "outputs")


@dataclass(frozen=True, kw_only=True, eq=False)
class LegSignatures:
    """Log odds z that a leg has failed rather than none, a network of one layer of K units.

    Of deviations D of unit size in K patterns P, and sizes e:  z = o0 + sum of o tanh(P D + S e + b)

    Attributes:
        patterns: in the frame of a leg, (K, 2 or 8, 12): lean toward its foot, across, contacts, by parts.
        sizes: weights of the sizes, (K, 3 or 5).
        biases: (K,).
        outputs: o, and the offset o0 at the end, (K + 1,).
    """

    patterns: FloatArray
    sizes: FloatArray
    biases: FloatArray
    outputs: FloatArray

    def of_leg(self, robot: Robot, gait: Gait, leg: int) -> FloatArray:
        """Patterns of a leg, 1..6, as they show in lean ahead and left and in all contacts, (K, 2 or 8, 12).

        Parts are those of the cycle of leg 1.
        """
        x_m, y_m, _ = robot.stance_feet_body[leg - 1]
        cos, sin = np.array([x_m, y_m]) / np.hypot(x_m, y_m)
        phases = gait.leg_phases
        later = round(PARTS * (phases[leg - 1] - phases[0]))
        toward, across, *feet = np.moveaxis(np.roll(self.patterns, -later, axis=-1), 1, 0)
        lean = [cos * toward - sin * across, sin * toward + cos * across]
        return np.stack([*lean, *(feet[(foot - leg + 1) % N_LEGS] for foot in range(len(feet)))], axis=1)


def save_signatures(path: Any, signatures: Mapping[str, LegSignatures], origin: dict[str, Any]) -> None:
    """Write signatures by their sensors, in single precision; raises ArchiveFileError if the disk refuses."""
    arrays = {
        f"{seen}_{name}": getattr(signatures[seen], name).astype(np.float32)
        for seen in SENSORS
        for name in ARRAYS
    }
    KIND.save(path, VERSION, {"origin": origin}, arrays)


def load_signatures(path: Any) -> dict[str, LegSignatures]:
    """Signatures of a file, by their sensors; raises InputError for a wrong, damaged or altered file."""
    return KIND.load(path, _made)


def _made(_head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> dict[str, LegSignatures]:
    return {
        seen: LegSignatures(**{name: arrays[f"{seen}_{name}"].astype(float) for name in ARRAYS})
        for seen in SENSORS
    }


@cache
def shipped_signatures() -> dict[str, LegSignatures]:
    """The shipped signatures, by their sensors; raises InputError for a damaged file."""
    return load_signatures(config_root() / "signatures" / "legs.npz")


@lru_cache(maxsize=512)
def leg_patterns(robot: Robot, gait: Gait, leg: int, seen: str) -> FloatArray:
    """Shipped patterns of a leg, 1..6, of a robot in a gait, as `LegSignatures.of_leg` has them."""
    patterns = shipped_signatures()[seen].of_leg(robot, gait, leg)
    patterns.flags.writeable = False
    return patterns
