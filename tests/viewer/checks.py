"""What must be seen of a recording; each check fails with what is missing."""

from hexctl import palette
from hexctl.recording import style
from pictures.picture import Color, Picture
from pictures.window import Window

#: Kinds of views that a trial is shown in, and how many at least.
TRIAL_VIEWS = {"3D": 1, "StateTimeline": 1, "TextDocument": 1, "TimeSeries": 3}
SESSION_VIEWS = {"2D": 1, "TimeSeries": 1, "TextDocument": 1}

#: Solids are shaded: how far their colours may be off.
SHADED = 60

#: Shares of a view that its subject covers at least.
BODY_SHARE, LEG_SHARE, LANE_SHARE, LINE_SHARE, TEXT_SHARE = 0.003, 0.0005, 0.25, 0.0002, 0.005
TEXT_COLOR: Color = (230, 230, 230)

#: The share of the scene that the trunk covers when all of the robot is in the picture.
WHOLE_SHARE = 0.12


def check_views(window: Window, kinds: dict[str, int]) -> None:
    """Fail unless there are views of all kinds, and none of them complains."""
    views = window.views
    found = [view.view_class for view in views]
    missing = {kind: count - found.count(kind) for kind, count in kinds.items() if found.count(kind) < count}
    assert not missing, f"views are missing: {missing}, there are {found}"
    troubles = {view.name: view.reports for view in views if view.reports}
    assert not troubles, f"views complain: {troubles}"


def of_kind(window: Window, kind: str) -> Picture:
    """The picture of the first view of a kind that is on the screen."""
    views = [view for view in window.views if view.view_class == kind]
    seen = next(filter(None, map(window.part, views)), None)
    assert seen is not None, f"no view of kind {kind} is on the screen"
    return seen


def check_robot(scene: Picture) -> None:
    """Fail unless a robot with a failed leg is in a picture of a scene."""
    assert not scene.blank, "the scene is blank"
    assert scene.share(palette.BODY_COLOR, SHADED) > BODY_SHARE, "no trunk is seen"
    assert scene.share(palette.FAILED_COLORS["femur"], SHADED) > LEG_SHARE, "no failed leg is seen"


def check_whole(scene: Picture) -> None:
    """Fail when the eye is so close to the robot that its feet are outside the picture."""
    share = scene.share(palette.BODY_COLOR, SHADED)
    assert share < WHOLE_SHARE, f"the trunk covers {100 * share:.0f} % of the scene"


def check_session(window: Window) -> None:
    """Fail unless the window shows a session: trajectories from above, the curve, the table."""
    check_views(window, SESSION_VIEWS)
    whole = window.picture()
    assert not whole.blank, "the window is blank"
    above = of_kind(window, "2D")
    assert above.share(palette.LINE_COLOR) > LINE_SHARE, "no line of travel is seen"
    assert above.share(palette.BEST_COLOR) > LINE_SHARE, "no best trajectory is seen"
    assert of_kind(window, "TimeSeries").share(palette.BEST_COLOR) > LINE_SHARE, "no convergence is seen"
    assert of_kind(window, "TextDocument").share(TEXT_COLOR) > TEXT_SHARE, "no table is seen"


def check_trial(window: Window) -> None:
    """Fail unless the window shows a trial: robot, lanes of phases and contacts, text, plots."""
    check_views(window, TRIAL_VIEWS)
    whole = window.picture()
    assert not whole.blank, "the window is blank"
    for joint in ("coxa", "femur"):
        assert whole.share(palette.JOINT_COLORS[joint][1]) > LINE_SHARE, f"no curve of {joint} is seen"
    assert whole.share(style.DEVIATION_COLOR) > LINE_SHARE, "no curve of the deviation is seen"
    check_robot(of_kind(window, "3D"))
    lanes = of_kind(window, "StateTimeline")
    assert lanes.filled > LANE_SHARE, "no lanes are seen"
    assert of_kind(window, "TextDocument").share(TEXT_COLOR) > TEXT_SHARE, "no text is seen"
