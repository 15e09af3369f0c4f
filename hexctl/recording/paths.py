"""Entity paths of a recording, shared by tracks, scene and blueprint."""

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
DEVIATION = "deviation"
MARGIN = "stability_margin"
#: 18 scalars at 10 Hz: the torque of each joint in N m.
TORQUES = "joint_torques"
#: 18 scalars each at every tick, the commanded and the measured angle of each joint in rad: the
#: vectors that converters to LeRobot look for.
ACTION, OBSERVATION = "action", "observation/state"
#: 18 scalars each, at 1 Hz: the servos' degrees Celsius, V and A, and ages of angles.
TEMPERATURES, VOLTAGES, CURRENTS = "servos/temperatures", "servos/voltages", "servos/currents"
AGES = "servos/ages"
#: Three scalars at 10 Hz: the commanded velocity of a steered walk, m/s, m/s and rad/s.
VELOCITY = "commanded_velocity"
#: The same as an arrow above the body: the distance of two seconds.
VELOCITY_ARROW = "world/robot/body/velocity"
#: Seven scalars at 10 Hz: the evidence against each leg, and the alarm level, 1.
SUSPICION = "leg_suspicion"
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
