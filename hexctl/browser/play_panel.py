"""The panel of `hexctl play`: legs, walk, robot, world and recording, as viser's controls.

All pages share it. Callbacks run in threads of the server, and leave requests for the robot's next tick.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

from hexctl.browser.play_options import PlayOptions
from hexctl.browser.played_robot import PlayedRobot
from hexctl.control.drive.drive import DRIVE_HOLDS
from hexctl.control.monitor.recovery import RECOVERIES
from hexctl.gait.body_pose import BodyPose
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.configs import config_names, config_root, is_family, read_mapping
from hexctl.robot.failure import Failure
from hexctl.teleop.drive_session import name_of
from hexctl.types import JOINT_KINDS, N_LEGS

INTACT = "intact"

#: What a leg can be made, by the words of the panel: kind, and joint or None.
LEG_CHOICES: dict[str, tuple[str, str | None]] = {
    "locked": ("locked", None),
    "limp": ("limp", None),
    "missing": ("missing", None),
    "weak": ("weak", None),
    **{f"{joint} {kind}": (kind, joint) for kind in ("limp", "weak", "stuck") for joint in JOINT_KINDS},
}

#: What a click makes of the leg, or of the joint, that it hits.
CLICKS = ("locked", "limp", "missing", "weak", "joint limp", "joint weak", "joint stuck", "healed")

#: Maxima of the sliders of the body.
TILT_DEG, RAISE = 12.0, 0.06

#: Shares of the maximum speed with which the robot walks by itself.
CRUISE = 0.7


def failure_of(leg: int, choice: str) -> Failure | None:
    """The failure of a choice of the panel; None heals."""
    if choice not in LEG_CHOICES:
        return None
    kind, joint = LEG_CHOICES[choice]
    return Failure(leg=leg, kind=kind, joint=joint)


def choice_of(failure: Failure | None) -> str:
    """The words of the panel for a failure."""
    if failure is None:
        return INTACT
    wanted = (failure.kind, failure.joint)
    return next((words for words, one in LEG_CHOICES.items() if one == wanted), failure.kind)


def plain_worlds() -> list[str]:
    """Shipped worlds, and the first member of each family."""
    names = config_names("worlds")
    folder = config_root() / "worlds"
    return [f"{name}:0" if is_family(read_mapping(folder / f"{name}.yaml")) else name for name in names]


class Stage(Protocol):
    """What plays: `hexctl.browser.play.Play`."""

    options: PlayOptions
    recovery_name: str

    def begin(self, **changes: Any) -> None:
        """Begin again with changed options."""

    def change_recovery(self, name: str) -> None:
        """Use another recovery from now on."""

    def record(self) -> str:
        """Begin a recording; returns a text for the page."""

    def open_recording(self, show: Callable[[str], object]) -> None:
        """End the recording and open it; `show` takes texts for the page."""


class PlayPanel:
    """Makes the controls, and keeps the legs' choices as the simulation has them."""

    def __init__(self, gui: Any, play: Stage, played: PlayedRobot) -> None:
        self._gui, self._play, self._played = gui, play, played
        self.click = CLICKS[0]
        gui.reset()
        gui.set_panel_label(f"{played.drive.robot.name} in {play.options.world}")
        self._legs: list[Any] = []
        self._shown: Any = None
        with gui.add_folder("Break a leg"):
            self._add_legs()
        with gui.add_folder("Walk"):
            self._add_walk()
        with gui.add_folder("Body", expand_by_default=False):
            self._add_body()
        with gui.add_folder("Robot and world"):
            self._add_scenario()
        with gui.add_folder("Recording"):
            self._add_recording()

    def clicked(self, leg: int, joint: str) -> None:
        """Do to a leg, or its joint, what a click does; a broken one is healed."""
        played, how = self._played, self.click
        joint_only = how.startswith("joint ")
        choice = f"{joint} {how.removeprefix('joint ')}" if joint_only else how

        def change() -> None:
            broken = {one.leg for one in played.simulation.failures}
            played.change_leg(leg, None if leg in broken else failure_of(leg, choice))

        played.soon(change)

    def report(self) -> None:
        """Show which legs are broken."""
        failures = self._played.simulation.failures
        if failures == self._shown:
            return
        self._shown, by_leg = failures, {one.leg: one for one in failures}
        for leg, chosen in enumerate(self._legs, start=1):
            chosen.value = choice_of(by_leg.get(leg))

    def _add_legs(self) -> None:
        gui, played = self._gui, self._played
        click = gui.add_dropdown("a click makes it", CLICKS, initial_value=self.click)
        _on_change(click, lambda value: setattr(self, "click", value))
        for leg in range(1, N_LEGS + 1):
            chosen = gui.add_dropdown(f"leg {leg}", (INTACT, *LEG_CHOICES))
            _on_change(chosen, partial(self._change_leg, leg))
            self._legs.append(chosen)
        heal = gui.add_button("Heal all legs")
        heal.on_click(lambda _: played.soon(lambda: _heal_all(played)))

    def _change_leg(self, leg: int, choice: str) -> None:
        def change() -> None:
            now = {one.leg: choice_of(one) for one in self._played.simulation.failures}
            if choice != now.get(leg, INTACT):
                self._played.change_leg(leg, failure_of(leg, choice))

        self._played.soon(change)

    def _add_walk(self) -> None:
        gui, played, drive = self._gui, self._played, self._played.drive
        cruise = gui.add_slider("walks by itself", 0.0, 1.0, 0.05, played.cruise[0])
        turn = gui.add_slider("turns", -1.0, 1.0, 0.05, played.cruise[1])
        for slider in (cruise, turn):
            _on_change(slider, lambda _: setattr(played, "cruise", (cruise.value, turn.value)))
        self.cruise = cruise
        gaits = tuple(dict.fromkeys((name_of(drive.gait.slots), *NAMED_SLOTS)))
        self._setting("gait", gaits, gaits[0], lambda value: setattr(drive, "gait", value))
        pace = gui.add_slider("pace (Hz)", 0.3, 2.5, 0.05, min(2.5, max(0.3, drive.gait.pace_hz)))
        _on_change(
            pace,
            lambda value: played.soon(lambda: setattr(drive, "gait", replace(drive.gait, pace_hz=value))),
        )
        self._setting("recovery", tuple(RECOVERIES), self._play.recovery_name, self._play.change_recovery)
        self._setting("hold", DRIVE_HOLDS, drive.hold, lambda value: setattr(drive, "hold", value))
        race = gui.add_checkbox("race a grey robot without recovery", played.rival is not None)
        _on_change(race, lambda value: self._play.begin(race=value))
        push = gui.add_button("Push")
        push.on_click(lambda _: played.soon(lambda: played.push(played.time_s % math.tau)))

    def _add_body(self) -> None:
        gui, drive = self._gui, self._played.drive
        size_m = drive.robot.size_m
        up = gui.add_slider("height (cm)", -100 * RAISE * size_m, 100 * RAISE * size_m, 0.1, 0.0)
        angles = [
            gui.add_slider(f"{name} (deg)", -TILT_DEG, TILT_DEG, 0.5, 0.0)
            for name in ("roll", "pitch", "yaw")
        ]

        def pose(_: Any) -> None:
            roll, pitch, yaw = (math.radians(slider.value) for slider in angles)
            asked = BodyPose(roll_rad=roll, pitch_rad=pitch, yaw_rad=yaw, up_m=up.value / 100)
            self._played.soon(lambda: drive.pose_body(asked))

        for slider in (up, *angles):
            _on_change(slider, pose)
        level = gui.add_checkbox("keep the body level", drive.level)
        _on_change(level, lambda value: self._played.soon(lambda: setattr(drive, "level", value)))

    def _add_scenario(self) -> None:
        gui, play, played = self._gui, self._play, self._played
        robots = tuple(dict.fromkeys((str(play.options.robot), *config_names("robots"))))
        worlds = tuple(dict.fromkeys((str(play.options.world), *plain_worlds())))
        robot = gui.add_dropdown("robot", robots, initial_value=robots[0])
        _on_change(robot, lambda value: play.begin(robot=value))
        world = gui.add_dropdown("world", worlds, initial_value=worlds[0])
        _on_change(world, lambda value: play.begin(world=value))
        follows = gui.add_checkbox("camera follows", played.follows)
        _on_change(follows, lambda value: setattr(played, "follows", value))
        reset = gui.add_button("Reset")
        reset.on_click(lambda _: play.begin())

    def _add_recording(self) -> None:
        gui, play = self._gui, self._play
        begin = gui.add_button("Record")
        end = gui.add_button("End and open", visible=False)
        self.recorded = gui.add_markdown("")

        def record(_: Any) -> None:
            begin.visible, end.visible = False, True
            self.recorded.content = play.record()

        def finish(_: Any) -> None:
            begin.visible, end.visible = True, False
            play.open_recording(lambda text: setattr(self.recorded, "content", text))

        begin.on_click(record)
        end.on_click(finish)

    def _setting(
        self, name: str, choices: tuple[str, ...], now: str, change: Callable[[str], object]
    ) -> None:
        shown = choices if now in choices else (now, *choices)
        chosen = self._gui.add_dropdown(name, shown, initial_value=now)
        _on_change(chosen, lambda value: self._played.soon(lambda: change(value)))


def _heal_all(played: PlayedRobot) -> None:
    for one in played.simulation.failures:
        played.change_leg(one.leg, None)


def _on_change(control: Any, change: Callable[[Any], object]) -> None:
    """Call with new values that come from a page, and not with those that the program sets."""

    def changed(event: Any) -> None:
        if event.client_id is not None:
            change(control.value)

    control.on_update(changed)
