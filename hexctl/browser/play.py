"""A simulated robot in a browser: driven, broken, pushed and raced from a page of this computer.

with Play(PlayOptions(robot="phantomx")) as play:
    print(play.url)
    play.run()
"""

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from datetime import datetime
from importlib.resources import files
from pathlib import Path
from typing import Any, Self

from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import load_world
from hexctl.browser.play_options import PlayOptions
from hexctl.browser.play_panel import CRUISE, PlayPanel
from hexctl.browser.play_socket import PlaySocket
from hexctl.browser.played_robot import PlayedRobot, rival_of
from hexctl.browser.scene_server import SceneServer, light_scene
from hexctl.control.drive.drive import Drive
from hexctl.control.log import PACED_BLOCK_TICKS, Recorders
from hexctl.control.monitor.recovery import Recovery, make_recovery
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import EStopError, HexctlError, RobotFaultError, SimulationDivergedError
from hexctl.recording.recording import Recording
from hexctl.robot.failure import Failure
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.teleop.control_page import with_common_parts
from hexctl.teleop.drive_session import DriveSession
from hexctl.waiting import StopRequested, never_stop

#: Where recordings are kept.
RUNS = Path("runs")

#: Reasons to end a session of driving: begin again.
AGAIN = "again"

#: Wait between two looks at requests while the robot is stopped by its guard.
STOPPED_S = 0.05


class Play:
    """Serves the page, and simulates in real time until it ends; a context manager.

    Args:
        runs: folder of recordings.

    Raises InputError for an invalid robot, world or gait, RobotFaultError for a port in use.
    """

    def __init__(self, options: PlayOptions | None = None, *, runs: Path = RUNS) -> None:
        self.options = options or PlayOptions()
        self._runs = runs
        self._loaded = load_robot_file(self.options.robot)
        load_world(self.options.world)
        make_recovery(self.options.recovery)
        self.recovery_name = self.options.recovery
        self._recoveries: dict[str, Recovery] = {}
        self._begins: dict[str, Any] | None = {}
        self._session: DriveSession | None = None
        self._played: PlayedRobot | None = None
        self._panel: PlayPanel | None = None
        self._recording: Recording | None = None
        self._ended = threading.Event()
        self._socket = PlaySocket()
        controls = with_common_parts(
            files("hexctl.browser").joinpath("controls.html").read_text(encoding="utf-8")
        )
        self._server = SceneServer(
            self.options.page_port, title="hexctl play", controls=controls, talk=self._socket.talk
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()
        self._server.__exit__()

    @property
    def url(self) -> str:
        """Address of the page."""
        return self._server.url

    def begin(self, **changes: Any) -> None:
        """Begin again, in the stance and with intact legs, with changed options; from any thread."""
        self._begins = changes
        if self._session is not None:
            self._session.ask("quit", AGAIN)

    def run(self, stop_requested: StopRequested = never_stop) -> None:
        """Simulate until a stop is requested; the page shows errors of a chosen robot or world."""
        said = ""
        while self._begins is not None and not stop_requested():
            changes, self._begins = self._begins, None
            before = self.options, self._loaded
            try:
                self.options = replace(self.options, **changes)
                self._loaded = load_robot_file(self.options.robot)
                said = self._play(stop_requested, said)
            except HexctlError as error:
                if not changes:
                    raise
                (self.options, self._loaded), said = before, str(error)
                self._begins = {}

    def _play(self, stop_requested: StopRequested, said: str) -> str:
        options, loaded = self.options, self._loaded
        world = load_world(options.world)
        floor = make_floor(world, options.seed)
        common: dict[str, Any] = {
            "world": world,
            "seed": options.seed,
            "gait": options.gait,
            "hold": options.hold,
            "level": options.level,
            "feet": options.feet,
        }
        with ExitStack() as stack:
            drive = Drive(loaded.robot, recovery=self._recovery(self.recovery_name), realtime=True, **common)
            stack.enter_context(drive)
            rival = rival_of(stack, loaded.robot, **common) if options.race else None
            viser = self._server.viser
            light_scene(viser, loaded.robot)
            played = PlayedRobot(viser.scene, drive, floor, loaded.meshes, rival, self._clicked)
            stack.callback(played.remove)
            if self._played is not None:
                played.cruise, played.follows = self._played.cruise, self._played.follows
            else:
                played.cruise = (CRUISE, 0.0)
            for note in (*drive.notes, *([said] if said else [])):
                played.say(note)
            self._played, self._panel = played, PlayPanel(viser.gui, self, played)
            stack.callback(self._finish_recording)
            self._drive(DriveSession(drive), played, stop_requested)
        return ""

    def _drive(self, session: DriveSession, played: PlayedRobot, stop_requested: StopRequested) -> None:
        drive, self._session = session.drive, session
        source = drive.arbiter.source("page")
        self._socket.attach(source, drive.share, self._asked)
        try:
            session.run([played, self], stop_requested)
        except (EStopError, SimulationDivergedError, RobotFaultError) as error:
            played.say(f"{drive.guard.stopped or error}; press Reset")
            while self._begins is None and not stop_requested():
                self.report(session.status(drive.guard.peek()))
                time.sleep(STOPPED_S)
        finally:
            self._session = None
            self._socket.detach()

    def break_leg(self, failure: Failure) -> None:
        """Break a leg in the next tick; from any thread."""
        played = self._played
        if played is not None:
            played.soon(lambda: played.change_leg(failure.leg, failure))

    def poll(self) -> None:
        """Nothing: requests arrive on other threads."""

    def report(self, status: dict[str, Any]) -> None:
        """Send the status to the pages; a part of `DriveSession`'s devices."""
        if self._played is not None and self._panel is not None:
            self._panel.report()
            own = self._played.status()
            self._socket.report({**status, **own, "world": str(self.options.world)})

    def change_recovery(self, name: str) -> None:
        """Use another recovery from now on."""
        if self._played is not None:
            self._played.drive.recovery = self._recovery(name)
            self.recovery_name = name

    def _recovery(self, name: str) -> Recovery:
        if name not in self._recoveries:
            self._recoveries[name] = make_recovery(name)
        return self._recoveries[name]

    def _asked(self, request: str) -> None:
        """A request of the page, on the server's thread; raises InputError for an unknown one."""
        session, played, panel = self._session, self._played, self._panel
        if session is None or played is None or panel is None:
            return
        if request == "reset":
            self.begin()
        elif request == "push":
            played.soon(lambda: played.push(played.time_s))
        elif request != "quit":
            if request in ("stop", "sit"):
                panel.cruise.value, played.cruise = 0.0, (0.0, 0.0)
            session.ask(request)

    def _clicked(self, leg: int, joint: str) -> None:
        if self._panel is not None:
            self._panel.clicked(leg, joint)

    def record(self) -> str:
        """Record from the next tick on; returns a text for the page."""
        played, loaded = self._played, self._loaded
        if played is None or self._recording is not None:
            return "recording"
        path = self._runs / f"play-{datetime.now():%Y%m%d-%H%M%S}-{loaded.robot.name}.rrd"
        try:
            recording = _recording(
                path, played.drive, loaded, make_floor(load_world(self.options.world), self.options.seed)
            )
        except HexctlError as error:
            return str(error)
        self._recording = recording
        recorders = Recorders(recording, block_ticks=PACED_BLOCK_TICKS)
        played.soon(lambda: played.drive.record(recorders))
        return f"recording to `{path}`"

    def open_recording(self, show: Callable[[str], object]) -> None:
        """End the recording, and serve it in Rerun's viewer; `show` takes texts for the page."""
        recording, played = self._recording, self._played
        if recording is None or played is None:
            return
        finished = threading.Event()
        played.soon(lambda: played.drive.record(None))
        played.soon(finished.set)
        finished.wait(STOPPED_S * 40)
        self._finish_recording()
        show(f"recorded in `{recording.path}`; opening")
        threading.Thread(target=self._serve_recording, args=(recording.path, show), daemon=True).start()

    def _serve_recording(self, path: Path, show: Callable[[str], object]) -> None:
        from hexctl.adapt.sessions.session_viewing import serve_runs

        def found(url: str) -> None:
            show(f"recorded in `{path}`: [open it]({url})")

        try:
            serve_runs([str(path)], self._runs, on_url=found, stop_requested=self._ended.is_set)
        except HexctlError as error:
            show(f"recorded in `{path}`; {error}")

    def _finish_recording(self) -> None:
        recording, self._recording = self._recording, None
        if recording is None:
            return
        if self._played is not None:
            self._played.drive.record(None)
        recording.__exit__(None, None, None)


def _recording(path: Path, drive: Drive, loaded: RobotFile, floor: Any) -> Recording:
    plan = TrialPlan(gait=drive.gait, duration_s=86_400.0, self_rotation="none", level=drive.level)
    title = f"{loaded.robot.name} played with"
    recording = Recording(
        path, loaded.robot, plan, title=title, floor=floor, meshes=loaded.meshes, watched=True
    )
    return recording.__enter__()
