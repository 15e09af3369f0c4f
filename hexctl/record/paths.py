"""Where things live in a recording: the entity paths that writer, scene and blueprint share."""

from hexctl.types import JOINT_KINDS, N_LEGS

#: Time since the first tick of the trial, and the time of day then.
TIMELINE = "trial_time"
WALL_TIMELINE = "wall_time"

WORLD = "world"
GROUND = "world/ground"
COURSE = "world/course"
TRAIL = "world/trail"
RIBBON = "world/ribbon"
POLYGON = "world/support_polygon"
CENTRE = "world/centre_of_gravity"
ROBOT = "world/robot"
BODY = "world/robot/body"
#: Nothing to be seen, as large as the robot: what the viewer's eye follows and fits into its picture.
FRAME = "world/robot/frame"
DEVIATION = "deviation"
MARGIN = "stability_margin"
PHASE = "phase"
GUARD = "guard"
EVENTS = "events"
SUMMARY = "summary"


def leg_path(leg: int) -> str:
    """Return the entity at the coxa axis of leg 1..6, fixed to the body."""
    return f"{ROBOT}/leg{leg}"


def link_path(leg: int, kind: str) -> str:
    """Return the entity of a link, such as `world/robot/leg5/coxa/hip/femur`: a link hangs on the one before.

    It holds the solid, the rotation that moves it, and two scalars: commanded and measured angle in rad.
    """
    joints = ("", "/hip", "/knee")
    links = zip(joints, JOINT_KINDS, strict=True)
    steps = [f"{joint}/{link}" for joint, link in links]
    return leg_path(leg) + "".join(steps[: JOINT_KINDS.index(kind) + 1])


def joint_path(leg: int, kind: str) -> str:
    """Return the entity of a link's place on the one before, such as `world/robot/leg5/coxa/hip`."""
    return link_path(leg, kind).rpartition("/")[0]


def foot_path(leg: int) -> str:
    """Return the entity of a foot, at the end of the tibia."""
    return f"{link_path(leg, 'tibia')}/foot"


def gait_path(leg: int) -> str:
    """Return the entity that says whether a foot is in stance or swing, commanded and felt."""
    return f"gait/leg{leg}"


LEGS = range(1, N_LEGS + 1)
