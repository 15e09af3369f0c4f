"""What a prior is an answer to, and whether that is what a session asks."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from hexctl.control.plan import TrialPlan
from hexctl.robot.model import Robot


@dataclass(frozen=True, kw_only=True)
class Question:
    """A robot, a kind of failure and a trial: a prior serves exactly the sessions with the same.

    Attributes:
        robot: its name.
        robot_fingerprint: of its description.
        failure: as the command line writes it, whichever leg it is.
        self_rotation: where the failed leg points during the walk.
        heading_deg: direction of travel as seen from the body; 0 where a self-rotation has turned it there.
        duration_s: how long a trial walks.
        pace_hz: of the gaits.
        amplitude: of the gaits.
        height: of the gaits.
    """

    robot: str
    robot_fingerprint: str
    failure: str
    self_rotation: str
    heading_deg: float
    duration_s: float
    pace_hz: float
    amplitude: float
    height: float

    @classmethod
    def of(cls, robot: Robot, plan: TrialPlan) -> "Question":
        """Return the question of a session's trials."""
        gait = plan.gait
        return cls(
            robot=robot.name,
            robot_fingerprint=robot.fingerprint,
            failure=str(plan.failure),
            self_rotation=plan.self_rotation,
            heading_deg=math.degrees(plan.heading_rad) if plan.self_rotation == "none" else 0.0,
            duration_s=plan.duration_s,
            pace_hz=gait.pace_hz,
            amplitude=gait.amplitude,
            height=gait.height,
        )

    def as_json(self) -> dict[str, Any]:
        """Return the question as plain JSON values."""
        return asdict(self)

    def differences(self, other: "Question") -> list[str]:
        """Return in what another question differs, a few words each; empty when it is the same."""
        found = []
        for name, mine in self.as_json().items():
            theirs = getattr(other, name)
            if mine == theirs:
                continue
            if name == "robot_fingerprint":
                if self.robot == other.robot:
                    found.append(f"another description of {self.robot}")
                continue
            label, unit = _LABELS.get(name, (name, ""))
            found.append(f"{label} {_short(mine)}{unit}, not {_short(theirs)}{unit}")
        return found


_LABELS = {
    "self_rotation": ("self-rotation", ""),
    "heading_deg": ("heading", " deg"),
    "duration_s": ("duration", " s"),
    "pace_hz": ("pace", " Hz"),
}


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
