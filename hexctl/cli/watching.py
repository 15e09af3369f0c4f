"""What `hexctl view --connect` does: show a robot on the network while it moves, without commanding it."""

import time
from typing import Any

from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.zenoh.client import ask_until
from hexctl.backends.zenoh.subscriber import LatestValues, StateSubscriber
from hexctl.cli.console import DONE, StopOnInterrupt, print_note
from hexctl.control.log import Recorders
from hexctl.control.plan import TrialPlan
from hexctl.control.trace import TrialFrame
from hexctl.errors import RobotFaultError
from hexctl.gait.gait import make_gait
from hexctl.record.live import LiveView
from hexctl.record.viewer import check_display
from hexctl.robot.model import Robot
from hexctl.robot.rotations import yaw_rad
from hexctl.types import JointTargets
from hexctl.wire.description import robot_of
from hexctl.wire.links import KeyMap, Link, Role, load_link
from hexctl.wire.session import open_session

#: How long a robot may take to say who it is.
PATIENCE_S = 3.0

#: After an hour another recording begins: what a recording holds is kept in memory, here and by its feeder.
TICKS_AT_ONCE = 180_000


def watch(*, web: bool, **options: Any) -> int:
    """Show the robot of a link until the viewer is closed or somebody interrupts; return the exit code.

    Raises RobotFaultError for a robot that is not there or falls silent, RecordingError without a screen.
    """
    link = load_link(options.pop("link"), **options)
    anybody = KeyMap.of("*").renamed(dict(link.names))
    with open_session(link, Role.VIEWER, anybody) as session, StopOnInterrupt() as interrupt:
        answers = ask_until(session, anybody.describe, timeout_s=PATIENCE_S)
        if not answers:
            raise RobotFaultError(f"no robot answers at {link.endpoint}; is hexctl serve running there?")
        robot = robot_of(answers[0])
        if not web:
            check_display()
        subscriber = StateSubscriber(link.keys(robot.name), LatestValues(), plain=link.plain)
        subscriber.subscribe(session)
        subscriber.wait_for_first_s()
        with LiveView(web=web) as live:
            if live.url is not None:
                print_note(f"open {live.url} in a browser; Ctrl-C ends it")
            try:
                while not interrupt.requested() and live.open:
                    title = f"{robot.name} at {link.endpoint}, from {time.strftime('%H:%M:%S')}"
                    live.begin(robot, _any_walk(robot), title=title)
                    _pass_on(subscriber, live, link, interrupt)
            except RobotFaultError:
                # A window keeps showing the last that came; a browser cannot ask for more.
                live.close(leave_viewer=not web)
                raise
            live.close(leave_viewer=False)
    return DONE


def _pass_on(subscriber: StateSubscriber, live: LiveView, link: Link, interrupt: StopOnInterrupt) -> None:
    """Read a robot's states at 50 Hz and show them, for as long as one recording may last."""
    recorders = Recorders(live)
    log = recorders.log
    log.phase = "walk"
    clock = WallClock(PERIOD_S)
    while not interrupt.requested() and live.lost is None and live.open and len(log) < TICKS_AT_ONCE:
        tick = clock.tick()
        state = subscriber.newest(tick.time_s)
        if log.frame is None and state.base_position_world is not None:
            assert state.base_quaternion_world is not None  # noqa: S101  they come together
            yaw = float(yaw_rad(state.base_quaternion_world))
            log.frame = TrialFrame(state.base_position_world, yaw, yaw)
        positions_rad = state.joint_positions_rad
        recorders.record(tick, state, positions_rad, JointTargets(positions_rad, tick.time_s))
    if live.lost is not None:
        raise RobotFaultError(f"{live.lost}; {link.endpoint} itself is as it was")


def _any_walk(robot: Robot) -> TrialPlan:
    """Return a plan for the layout: what the robot is told to do is not for a viewer to know."""
    return TrialPlan(gait=make_gait(robot, "demo"))
