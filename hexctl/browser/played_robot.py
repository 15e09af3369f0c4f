"""A simulated robot in the scene of a page, with a grey one next to it that does not recover."""

from collections import deque
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import numpy as np

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.terrain import Floor
from hexctl.browser.floor_scene import FloorScene, heights_at
from hexctl.browser.robot_scene import OnClick, RobotScene
from hexctl.control.drive.drive import Drive
from hexctl.errors import HexctlError
from hexctl.robot.failure import Failure, in_words
from hexctl.robot.meshes import Meshes
from hexctl.robot.rotations import yaw_rad
from hexctl.teleop.drive_session import Travel
from hexctl.types import N_LEGS, RobotState

#: Ticks between two pictures of the scene, and between two drawings of the path.
SCENE_TICKS, PATH_TICKS = 2, 15

#: The grey robot walks this much to the side, in stance radii.
ASIDE = 2.4

#: Lines of the log on the page.
LOG_LINES = 6

#: Reports in which late ticks are counted: 10 s.
LATE_REPORTS = 100

#: A push: its force in weights of the robot, and its duration.
PUSH_WEIGHTS, PUSH_S = 1.2, 0.2


class PlayedRobot:
    """Shows a simulated drive, and breaks its legs; a device of its `DriveSession`.

    Requests of other threads are done in ticks (`soon`). A `rival` is another simulated drive: it is stepped
    along, follows the same velocity, and loses the same legs.
    """

    def __init__(
        self, scene: Any, drive: Drive, floor: Floor, meshes: Meshes, rival: Drive | None, on_click: OnClick
    ) -> None:
        self.drive, self.simulation, self.rival = drive, simulation_of(drive), rival
        self.cruise = (0.0, 0.0)
        self.follows = True
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self._floor = floor
        self._world = scene.add_frame("/world", show_axes=False)
        self._ground = FloorScene(scene, "/world/floor", floor)
        self._robot = RobotScene(scene, "/world/robot", drive.robot, meshes, floor, on_click=on_click)
        self._grey = None
        if rival is not None:
            self._grey = RobotScene(scene, "/world/rival", drive.robot, meshes, floor, grey=True)
            aside = ASIDE * drive.robot.stance_radius_m if floor.heights_m is None else 0.0
            self._grey.place(np.array([0.0, aside, heights_at(floor, np.array([[0.0, aside]]))[0]]))
        self._todo: deque[Callable[[], object]] = deque()
        self._began_s = drive.guard.clock.now_s
        self._overruns = deque([drive.guard.clock.overruns], maxlen=LATE_REPORTS)
        self._ticks, self._begun = 0, False
        self._travel, self._rival_travel = Travel(), Travel()
        self._contacts: list[int] = []
        self._shown_failures: Any = None
        self._broken_at_s: dict[int, float] = {}
        self._noticed = 0

    def remove(self) -> None:
        """Take everything out of the scene."""
        self._world.remove()

    def soon(self, request: Callable[[], object]) -> None:
        """Do something in the next tick; from any thread."""
        self._todo.append(request)

    @property
    def time_s(self) -> float:
        """Simulated time since this robot began."""
        return float(self.drive.guard.clock.now_s - self._began_s)

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        """Break a leg, or heal it for None; the rival's too."""
        self.simulation.change_leg(leg, failure)
        if self.rival is not None:
            simulation_of(self.rival).change_leg(leg, failure)
        self._broken_at_s[leg] = self.time_s
        what = "healed" if failure is None else in_words(failure)
        self.say(f"leg {leg} {what}")

    def push(self, direction_rad: float) -> None:
        """Push the trunk sideways, in a direction of the world."""
        weight_n = 9.81 * self.drive.robot.mass_kg
        force = PUSH_WEIGHTS * weight_n * np.array([np.cos(direction_rad), np.sin(direction_rad), 0.0])
        self.simulation.push(force, PUSH_S)
        if self.rival is not None:
            simulation_of(self.rival).push(force, PUSH_S)
        self.say("pushed")

    def say(self, text: str) -> None:
        """Add a line to the log of the page."""
        self.log.append(f"{self.time_s:.1f} s: {text}")

    def poll(self) -> None:
        """Do what was asked, and show where the robot is."""
        while self._todo:
            try:
                self._todo.popleft()()
            except HexctlError as error:
                self.say(str(error))
        forward, turn = self.cruise
        if self.drive.mode == "driving" and self.drive.stopped is None:
            velocity = self.drive.share(forward, 0.0, turn)
            self.drive.command(velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s)
        self._step_rival()
        state = self.simulation.true_state()
        contacts = state.foot_contacts
        assert contacts is not None  # noqa: S101  the truth has them
        self._contacts.append(int(contacts @ (1 << np.arange(N_LEGS))))
        if self._ticks % SCENE_TICKS == 0:
            self.show(state)
        self._ticks += 1

    def show(self, state: RobotState) -> None:
        """Draw robot, floor and path as they are now."""
        position_m, quaternion = state.base_position_world, state.base_quaternion_world
        assert position_m is not None and quaternion is not None  # noqa: S101, PT018  the truth has them
        if not self._begun and self.drive.mode == "driving":
            self._begun = True
            self._ground.begin(position_m, float(yaw_rad(quaternion)))
        self._ground.follow(position_m)
        self._robot.show(state)
        if self._grey is not None and (rival := self._rival_state()) is not None:
            self._grey.show(rival)
        if self._ticks % PATH_TICKS == 0 and self._begun:
            self._ground.draw_path()
        if self.follows:
            below_m = float(heights_at(self._floor, position_m[np.newaxis, :2])[0])
            self._world.position = (-position_m[0], -position_m[1], -below_m)
        failures = self.simulation.failures, self.drive.failures
        if failures != self._shown_failures:
            self._shown_failures = failures
            failed, noticed = ({one.leg: one for one in some} for some in failures)
            self._robot.color(failed, noticed)
            if self._grey is not None:
                self._grey.color(failed, {})

    def report(self, status: dict[str, Any]) -> None:
        """Take the status of the session; see `status`."""
        self._travel.add(self.simulation.true_state(), self.drive.guard.clock.now_s)
        if (rival := self._rival_state()) is not None:
            self._rival_travel.add(rival, self.drive.guard.clock.now_s)
        for one in self.drive.noticed[self._noticed :]:
            broken_at_s = self._broken_at_s.get(one.failure.leg)
            after = "" if broken_at_s is None else f" {self.time_s - broken_at_s:.1f} s later"
            self.say(f"{one.in_words}: detected{after}, {one.did}")
        self._noticed = len(self.drive.noticed)

    def status(self) -> dict[str, Any]:
        """What the page shows, in addition to the session's status."""
        contacts, self._contacts = self._contacts, []
        self._overruns.append(self.drive.guard.clock.overruns)
        return {
            "time_s": round(self.time_s, 2),
            "distance_m": self._travel.distance_m,
            "speed_m_s": self._travel.speed_m_s,
            "rival_m": None if self.rival is None else self._rival_travel.distance_m or 0.0,
            "contacts": contacts,
            "broken": [f"leg {one.leg} {in_words(one)}" for one in self.simulation.failures],
            "broken_legs": [one.leg for one in self.simulation.failures],
            "late": self._overruns[-1] - self._overruns[0],
            "log": list(self.log),
        }

    def _step_rival(self) -> None:
        if self.rival is None:
            return
        velocity = self.drive.decision.velocity
        if self.drive.stopped is not None and self.drive.arbiter.stopped is not None:
            velocity = type(velocity)()
        self.rival.command(velocity.forward_m_s, velocity.left_m_s, velocity.turn_rad_s)
        try:
            self.rival.step()
        except HexctlError as error:
            self.say(f"the grey robot: {error}")
            self.rival = None

    def _rival_state(self) -> RobotState | None:
        return None if self.rival is None else simulation_of(self.rival).true_state()


def simulation_of(drive: Drive) -> SimServos:
    """The simulation behind the guard of a simulated drive."""
    servos = drive.guard.unwrapped
    assert isinstance(servos, SimServos)  # noqa: S101  play only simulates
    return servos


def rival_of(stack: ExitStack, robot: Any, **options: Any) -> Drive:
    """Another simulated robot, which changes nothing when a leg fails; `stack` disconnects it."""
    return stack.enter_context(Drive(robot, recovery="walk-on", **options))
