"""The colours of a recording, (red, green, blue), and the series of the plots."""

BACKGROUND = (24, 28, 36)
GROUND_COLOR = (52, 60, 70)
GRID_COLOR = (255, 255, 255, 26)
BODY_COLOR = (58, 110, 165)
NOSE_COLOR = (240, 240, 240)
LINK_COLORS = {"coxa": (126, 144, 164), "femur": (186, 198, 212), "tibia": (226, 232, 240)}
FAILED_COLORS = {"coxa": (190, 44, 30), "femur": (226, 66, 42), "tibia": (246, 98, 66)}
TOUCHING_COLOR = (64, 220, 120)
LIFTED_COLOR = (96, 108, 124)
TRAIL_COLOR = (255, 190, 40)
COURSE_COLOR = (120, 170, 255)
DEVIATION_COLOR = (255, 200, 60)

#: Commanded pale, measured strong; one hue per joint.
SERIES = {
    "coxa": ((150, 190, 255), (50, 120, 255)),
    "femur": ((255, 200, 140), (255, 140, 20)),
    "tibia": ((160, 240, 180), (30, 190, 90)),
}

#: The states of a foot and the parts of a trial, in the timelines.
TOUCHING, LIFTED = "touching", "lifted"
STATE_COLORS = {
    TOUCHING: (44, 150, 84),
    LIFTED: (44, 50, 60),
    "settle": (96, 104, 118),
    "turn": (130, 90, 180),
    "walk": (50, 100, 160),
    "stop": (96, 104, 118),
}
