"""Entity paths of a recording, shared by tracks, scene and blueprint; those of numbers are in `series`."""

from hexctl.types import JOINT_KINDS, N_LEGS

#: Time since the walk began, as in results and events; 0 before it.
WALK_TIMELINE = "walk_time"
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
#: Invisible and as large as the robot: the viewer's eye follows it and fits it into the picture.
FRAME = "world/robot/frame"
#: The commanded velocity as an arrow above the body: the distance of two seconds.
VELOCITY_ARROW = "world/robot/body/velocity"
#: Broken legs, if known, and legs that the walk suspects or considers broken.
BROKEN, NOTICED = "failures/world", "failures/noticed"
PHASE = "phase"
GUARD = "guard"
EVENTS = "events"
SUMMARY = "summary"


def leg_path(leg: int) -> str:
    """Entity at the coxa axis of leg 1..6, fixed to the body."""
    return f"{ROBOT}/leg{leg}"


def link_path(leg: int, kind: str) -> str:
    """Entity of a link, such as `world/robot/leg5/coxa/hip/femur`."""
    joints = ("", "/hip", "/knee")
    links = zip(joints, JOINT_KINDS, strict=True)
    steps = [f"{joint}/{link}" for joint, link in links]
    return leg_path(leg) + "".join(steps[: JOINT_KINDS.index(kind) + 1])


def joint_path(leg: int, kind: str) -> str:
    """Entity of a link's origin on the previous link, such as `world/robot/leg5/coxa/hip`."""
    return link_path(leg, kind).rpartition("/")[0]


def foot_path(leg: int) -> str:
    """Entity of a foot, at the end of the tibia."""
    return f"{link_path(leg, 'tibia')}/foot"


def noticed_path(leg: int) -> str:
    """Entity of the mark at the hip of a leg whose failure the walk detected."""
    return f"{leg_path(leg)}/noticed"


def label_path(path: str) -> str:
    """Entity of the label of a foot or of a mark: a label has the colour of its point."""
    return f"{path}/label"


def gait_path(leg: int) -> str:
    """Entity of a foot's state: stance or swing, as commanded and as measured."""
    return f"gait/leg{leg}"


LEGS = range(1, N_LEGS + 1)
