"""The loaded parts of a session spec: robot, world, plan and prior; and notes about them."""

import logging
import shlex
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from hexctl.adapt.arena import check_radius
from hexctl.adapt.optimizer import Trim
from hexctl.adapt.optimizers.shipped import BAYES, STRIDES, TRIM
from hexctl.adapt.prior.prior import Prior, ScorePrior, load_prior, load_score_prior
from hexctl.adapt.prior.prior_files import check_prior
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World, load_world, without_step
from hexctl.control.planning.top_speed import Stride
from hexctl.control.scoring.score import ideal_distance_m, progress_floor_m
from hexctl.control.scoring.uncertainty_store import COMPUTATION, CONFIRM_STEP_S, known_uncertainty
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import check_plan
from hexctl.errors import InputError, argument
from hexctl.gait.encoding import Slots
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk

#: Default duration of the walks of `hexctl check --physics`; the uncertainty of shorter ones is unknown.
MEASURED_S = 30.0

_LOG = logging.getLogger(__name__)

#: Takes a sentence that a person should read; nothing depends on it.
Note = Callable[[str], None]


def log_note(text: str) -> None:
    """Log a note, the default of `Note`."""
    _LOG.info(text)


@dataclass(frozen=True, slots=True)
class Setting:
    """Loaded spec; `plan` has the demo gait, `world` is None on a real robot, `prior` without one."""

    robot_file: RobotFile
    world: World | None
    plan: TrialPlan
    prior: Prior | ScorePrior | None = None

    @property
    def robot(self) -> Robot:
        """The robot that walks."""
        return self.robot_file.robot

    def plan_for(self, slots: Slots, trim: Trim | None = None, stride: Stride | None = None) -> TrialPlan:
        """Plan of the trial of a gait; in open loop only a trim turns."""
        gait = replace(self.plan.gait, slots=slots)
        if stride is not None:
            gait = stride.applied(gait, self.plan.failed_legs)
        plan = replace(self.plan, gait=gait)
        if trim is None:
            return plan
        turn_rad_s = trim.turn_rad_s if plan.hold == "none" else None
        return replace(plan, trim_rad=trim.course_rad, turn_trim_rad_s=turn_rad_s)

    @property
    def ideal_m(self) -> float:
        """Distance of a walk without slip."""
        return ideal_distance_m(self.robot, self.plan, self.plan.duration_s)


def load_setting(spec: SessionSpec) -> Setting:
    """Load the parts of a spec.

    Raises InputError for a robot or a prior that has changed since the session began, or a file that cannot
    be used; ReachError or LimitError for trials that the legs cannot walk.
    """
    file = load_robot_file(spec.robot)
    robot = file.robot
    if robot.fingerprint != spec.robot_fingerprint:
        raise InputError(
            f"session: robot {spec.robot} is not the one that it began with; "
            "allowed: the same robot file, or a new session"
        )
    world = load_world(spec.world) if spec.world is not None else None
    walk = RunSpec(
        gait="demo",
        body_raise=spec.body_raise,
        heading_rad=spec.heading_rad,
        duration_s=spec.duration_s,
        failure=spec.broken,
        self_rotation=spec.self_rotation,
        hold=spec.hold,
    )
    plan = plan_walk(walk, robot)
    check_plan(robot, plan)
    return Setting(file, world, plan, prior_of(spec, robot, plan))


def prior_of(spec: SessionSpec, robot: Robot, plan: TrialPlan) -> Prior | ScorePrior | None:
    """The prior of a session, or None; raises InputError for a file that is no prior, or has changed."""
    if spec.prior is None:
        return None
    path = Path(spec.prior)
    check_prior(path, robot, plan)
    prior = load_prior(path) if spec.hold == "none" else load_score_prior(path)
    if spec.prior_digest and prior.digest != spec.prior_digest:
        raise InputError(
            f"prior {path}: is not the one the session began with; allowed: the same file, or a new session"
        )
    return prior


def start_note(spec: SessionSpec, setting: Setting) -> str | None:
    """Note for an operator before the robot moves, or None; raises InputError for a too small arena."""
    if spec.arena_m is not None:
        least_m = progress_floor_m(setting.robot, setting.plan, spec.duration_s)
        return check_radius(spec.arena_m, ideal_m=setting.ideal_m, least_m=least_m)
    if spec.simulated and not spec.all_sensors and "position" not in setting.robot.sensors:
        return (
            f"{setting.robot.name} measures no position: each end is that of the simulation, as with a tape; "
            f"on the robot {argument('ask')}"
        )
    if spec.simulated or spec.ask:
        return None
    return (
        "each trial begins where the last one ended, so the robot will wander; --arena RADIUS keeps it near"
    )


def baseline_note(spec: SessionSpec) -> str | None:
    """Note on the duration of a real robot's baseline, or None."""
    if spec.simulated or not spec.baseline_gaits:
        return None
    count = len(spec.baseline_gaits)
    return (
        f"{count} walks of {spec.duration_s:g} s come before the first trial, with the gaits it would use "
        f"anyway ({', '.join(spec.baseline_gaits)}); --no-baseline leaves them out"
    )


def budget_note(spec: SessionSpec) -> str | None:
    """Note that a budget is larger than the number of gaits that are walked once each, or None."""
    gaits = GaitSpace((spec.broken.leg,)).size
    if spec.optimizer in (BAYES, TRIM, STRIDES) or spec.count_repeats or spec.budget - spec.confirm <= gaits:
        return None
    confirming = f" and {spec.confirm} to confirm" if spec.confirm else ""
    most = f"{gaits}{confirming} are walked: there are {gaits} gaits"
    return f"of the budget of {spec.budget} trials at most {most}"


def with_known_uncertainty(spec: SessionSpec, setting: Setting, folder: Path, note: Note) -> SessionSpec:
    """Spec with the simulation's own uncertainty of its trials, if it was measured, else a note.

    Real robots, other objectives than the end of a walk, and steered walks have none; trimmed walks need that
    of their own world. `note` is called with the command that measures it. Raises InputError for a damaged
    file of measurements in `folder`.
    """
    if setting.world is None or spec.objective != "final" or spec.hold != "none":
        return spec
    found = known_uncertainty(setting.robot, setting.world, duration_s=spec.duration_s, folder=folder)
    if found is not None and found.borrowed and spec.optimizer == TRIM:
        return spec
    if found is not None:
        as_fine = setting.world.time_step_s <= CONFIRM_STEP_S
        return replace(
            spec,
            uncertainty_m=round(found.numerical_m, 4),
            uncertainty_caveat=found.caveat(str(spec.broken)),
            # Walks that confirm a gait are no finer then.
            confirmed_uncertainty_m=0.0 if as_fine or spec.optimizer == TRIM else found.confirmed_m or 0.0,
        )
    if spec.duration_s >= MEASURED_S:
        command = _measuring(spec)
        note(f"the simulation's own uncertainty is not known here; {command} measures it")
    return spec


def _measuring(spec: SessionSpec) -> str:
    name = without_step(str(spec.world))
    world, usual = load_world(name), World()
    words = ["hexctl", "check", spec.robot, "--physics"]
    if any(getattr(world, field) != getattr(usual, field) for field in COMPUTATION):
        words += ["--world", name]
    if spec.duration_s != MEASURED_S:
        words += ["--duration", f"{spec.duration_s:g}"]
    return shlex.join(words)
