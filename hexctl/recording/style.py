"""The colours of a recording in addition to those of `hexctl.palette`, and the states of its lanes."""

from itertools import combinations

from hexctl.palette import FAILED_COLORS, LINE_COLOR, NOTICED_COLORS, PATH_COLOR
from hexctl.robot.failure import FAILURE_KINDS
from hexctl.types import JOINT_KINDS, N_LEGS

Color = tuple[int, ...]

GRID_COLOR = (255, 255, 255, 26)
NOSE_COLOR = (240, 240, 240)
WHITE = (255, 255, 255)
NOTICED_COLOR = NOTICED_COLORS["femur"]
TOUCHING_COLOR = (64, 220, 120)
LIFTED_COLOR = (96, 108, 124)
UNFELT_COLOR = (206, 212, 220)
TRAIL_COLOR = DEVIATION_COLOR = PATH_COLOR
COURSE_COLOR = LINE_COLOR

#: The ribbon between line and trail, by side of the robot; the fourth number is the opacity.
LEFT_COLOR = (70, 190, 230, 110)
RIGHT_COLOR = (226, 96, 190, 110)

#: Support polygon and centre of gravity: stable, and unstable.
STEADY_COLOR, STEADY_FILL = (90, 230, 140), (60, 200, 110, 70)
UNSTEADY_COLOR, UNSTEADY_FILL = (255, 70, 60), (255, 60, 50, 110)
PLUMB_COLOR = (200, 206, 214)

#: States of a foot: commanded to be in stance or swing; with contacts also lifted or touching.
STANCE, SWING = "stance", "swing"
HANGS, DRAGS = "stance without contact", "swing with contact"
FELT_STATES = (HANGS, STANCE, SWING, DRAGS)

#: States of the guard and the clock.
GUARD_STATES = ("as commanded", "clipped", "ticks missed")
STOPPED = "stopped"

#: Lanes of failures while nothing is wrong.
WHOLE, WATCHING = "all legs whole", "no leg noticed"

#: Prefixes of states of broken legs, and of legs considered broken: each lane has its own colour.
BROKEN, NOTICED = "broken: ", "noticed: "


def broken_state(words: str) -> str:
    """State of the lane of broken legs, such as `leg 5 limp`; empty for no words."""
    return f"{BROKEN}{words}" if words else WHOLE


def noticed_state(words: str) -> str:
    """State of the lane of detected failures; empty for no words."""
    return f"{NOTICED}{words}" if words else WATCHING


def label_of(state: str) -> str:
    """Text of a state in its lane: short, and empty if the colour suffices."""
    return " " if state in WORDLESS else state.removeprefix(BROKEN).removeprefix(NOTICED)


def _failure_words() -> list[str]:
    legs = range(1, N_LEGS + 1)
    kinds = [
        *FAILURE_KINDS,
        *(f"{joint} {kind}" for joint in JOINT_KINDS for kind in ("limp", "weak", "stuck")),
    ]
    several = [", ".join(map(str, few)) for count in (2, 3) for few in combinations(legs, count)]
    return [f"leg {leg} {kind}" for leg in legs for kind in kinds] + [f"legs {few}" for few in several]


#: Colours of the states of lanes. Those in `WORDLESS` have no label.
LANE_COLORS = {
    STANCE: (206, 212, 220),
    SWING: (38, 43, 52),
    HANGS: (180, 105, 0),
    DRAGS: (225, 50, 80),
    "settle": (96, 104, 118),
    "turn": (130, 90, 180),
    "walk": (50, 100, 160),
    "stop": (96, 104, 118),
    GUARD_STATES[0]: (38, 43, 52),
    GUARD_STATES[1]: (226, 150, 40),
    GUARD_STATES[2]: (226, 66, 42),
    STOPPED: (226, 66, 42),
    WHOLE: (38, 43, 52),
    WATCHING: (38, 43, 52),
    **{broken_state(words): FAILED_COLORS["coxa"] for words in _failure_words()},
    **{noticed_state(words): NOTICED_COLOR for words in _failure_words()},
}
WORDLESS = (*FELT_STATES, *GUARD_STATES[:2], WHOLE, WATCHING)


def packed(color: Color) -> int:
    """Colour as Rerun packs it: 0xRRGGBBAA."""
    red, green, blue, alpha = (*color, 255)[:4]
    return red << 24 | green << 16 | blue << 8 | alpha
