"""Where things live in a recording: the entity paths that writer, scene and blueprint share."""

from hexctl.robot.joints import JOINT_KINDS, N_LEGS

#: The only timeline: time since the first tick of the trial.
TIMELINE = "trial_time"

WORLD = "world"
GROUND = "world/ground"
COURSE = "world/course"
TRAIL = "world/trail"
ROBOT = "world/robot"
BODY = "world/robot/body"
DEVIATION = "deviation"
PHASE = "phase"
SUMMARY = "summary"


def leg_path(leg: int) -> str:
    """Return the entity at the coxa axis of leg 1..6, fixed to the body."""
    return f"{ROBOT}/leg{leg}"


def link_path(leg: int, kind: str) -> str:
    """Return the entity of a link, such as `world/robot/leg5/coxa/femur`: a link hangs on the one before.

    It holds the solid, the rotation that moves it, and two scalars: commanded and measured angle in rad.
    """
    return "/".join([leg_path(leg), *JOINT_KINDS[: JOINT_KINDS.index(kind) + 1]])


def foot_path(leg: int) -> str:
    """Return the entity of a foot, at the end of the tibia."""
    return f"{link_path(leg, 'tibia')}/foot"


def contact_path(leg: int) -> str:
    """Return the entity that says whether a foot touches the floor."""
    return f"touch/leg{leg}"


LEGS = range(1, N_LEGS + 1)
