"""The run that makes the motions of an identification on a stand."""

from dataclasses import replace
from typing import Any

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.robot_options import RecordedOptions
from hexctl.backends.sim.world import World, load_world
from hexctl.control.preparation import WalkStart
from hexctl.errors import InputError, argument
from hexctl.identify.stand_motions import StandMotions
from hexctl.options import check_names
from hexctl.runs.run import Run, RunResult
from hexctl.runs.run_spec import RunSpec
from hexctl.waiting import StopRequested, never_stop


class IdentificationRun(Run):
    """A run that makes the motions on the stand: connected and recorded like a walk."""

    def __init__(self, spec: RunSpec) -> None:
        """Check a spec, whose gait and motion are ignored; raises InputError for a world without a stand."""
        if spec.simulated:
            world = load_world("stand") if spec.world is None else spec.world
            world = world if isinstance(world, World) else load_world(world)
            if not world.on_stand:
                raise InputError(
                    f"{argument('world')}: got one without a stand; allowed: stand, or one with on_stand"
                )
            spec = replace(spec, world=world)
        plain = {"hold": "none", "self_rotation": "none", "duration_s": 120.0, "gait": "demo"}
        super().__init__(replace(spec, **plain), controller=self._make_motions)  # type: ignore[arg-type]
        self.plan = replace(self.plan, failures=(), travel=0.0)

    @property
    def _walk_text(self) -> str:
        return "identification"

    @property
    def on_stand(self) -> bool:
        """A simulated one in its world, a real one as its operator was asked."""
        return True

    def _make_motions(self, start: WalkStart) -> StandMotions:
        return StandMotions(start.robot, start.period_s)

    @property
    def motions_s(self) -> float:
        """Duration of the motions."""
        return StandMotions(self.robot, PERIOD_S).duration_s


def move_on_stand(*, stop_requested: StopRequested = never_stop, **where: Any) -> RunResult:
    """Make the motions on a stand and record them; `where` are fields of `RecordedOptions`.

    Raises InputError before anything moves, RobotFaultError for a robot or a link that fails.
    """
    check_names(move_on_stand, where, RecordedOptions)
    with IdentificationRun(RunSpec(**where)) as connected:
        return connected.walk(stop_requested=stop_requested)
