"""The plan of a walk, from the options of a run: the one place that chooses gait, posture and changes."""

from dataclasses import replace

from hexctl.control.planning.crawl import auto_gait
from hexctl.control.planning.static_stability import check_tucked, stable_slots_of
from hexctl.control.planning.top_speed import fastest_gait
from hexctl.control.trial_plan import GaitChange, TrialPlan, suited_rotation
from hexctl.control.walks.ground_contact import step_height
from hexctl.errors import InputError, argument
from hexctl.gait.gait import AUTO, CHOSEN_GAITS, SWING_SHARE, Gait, make_gait, parse_slots
from hexctl.gait.posture import Posture
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec, name_and_time


def plan_walk(spec: RunSpec, robot: Robot) -> TrialPlan:
    """Plan of the walk of a spec; raises InputError for a bad gait, posture or motion."""
    spec.check_gaits()
    plan = TrialPlan(
        gait=_typed_gait(spec, robot),
        level=spec.level,
        heading_rad=spec.heading_rad or 0.0,
        travel=0.0 if spec.turn_rate_rad_s is not None and spec.heading_rad is None else 1.0,
        turn_rate_rad_s=spec.turn_rate_rad_s or 0.0,
        duration_s=spec.duration_s,
        failures=spec.failures,
        self_rotation=suited_rotation(
            "none" if len(spec.failures) > 1 else spec.self_rotation,
            spec.hold if spec.turn_rate_rad_s is None else "none",
            chosen_gait=spec.gait == AUTO or spec.chosen_gait,
        ),
        hold=spec.hold,
        feet=spec.feet,
        trim_rad=spec.trim_rad or 0.0,
        turn_trim_rad_s=spec.turn_trim_rad_s,
    )
    if spec.gait == AUTO:
        plan = replace(plan, gait=auto_gait(robot, plan, stand_up=spec.body_raise is None))
    if spec.fast:
        plan = replace(plan, gait=fastest_gait(robot, plan, reorder=spec.gait == AUTO))
    check_tucked(robot, plan)
    return replace(plan, changes=tuple(_change(spec, robot, plan, typed) for typed in spec.then))


def _typed_gait(spec: RunSpec, robot: Robot) -> Gait:
    """For `auto` the default gait, of which only the slots are replaced."""
    if isinstance(spec.gait, Gait):
        return spec.gait
    gait = make_gait(
        robot,
        "demo" if spec.gait == AUTO else spec.gait,
        pace_hz=spec.pace_hz,
        amplitude=spec.amplitude,
        height=step_height(robot, spec.feet) if spec.height is None else spec.height,
        failed_legs=spec.failed_legs,
        others=CHOSEN_GAITS,
    )
    return replace(
        gait,
        posture=Posture(
            body_raise=spec.body_raise or 0.0,
            shift=spec.stance_shift or (0.0, 0.0),
            tucked_legs=tuple(spec.tucked_legs),
        ),
        swing_share=SWING_SHARE if spec.swing_share is None else spec.swing_share,
    )


def _change(spec: RunSpec, robot: Robot, plan: TrialPlan, typed: str | GaitChange) -> GaitChange:
    """A change of a text such as `wave@10` keeps the posture of the plan's gait, but not its crawl."""
    if isinstance(typed, GaitChange):
        return typed
    name, at_s = name_and_time(typed)
    if name == AUTO and len(plan.failures) > 1:
        return GaitChange(gait=auto_gait(robot, plan, stand_up=spec.body_raise is None), at_s=at_s)
    gait = plan.gait
    if gait.phases is not None:  # a gait of slots has the swings of the paper
        gait = replace(
            gait, phases=None, swing_share=SWING_SHARE, posture=replace(gait.posture, shift=(0.0, 0.0))
        )
    try:
        slots = (
            stable_slots_of(robot, plan)
            if name == AUTO
            else parse_slots(name, plan.failed_legs, CHOSEN_GAITS)
        )
    except InputError as error:
        raise InputError(f"{argument('then')}: got {typed!r} ({error})") from error
    return GaitChange(gait=replace(gait, slots=slots), at_s=at_s)
