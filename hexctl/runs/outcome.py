"""The outcome of a run as plain values: parts of the object that `hexctl run --json` prints.

It has the keys of `TrialResult.to_dict` and these:

Attributes:
    gait: `name`, `slots`, `code` (null without one), `posture`, `swing_share`, `phases`, and `then`: changes
        of the gait; null for a custom controller without a gait
    task: heading, turn and pace in words, such as `walk ahead`; null for a custom controller
    failed_leg: the failed leg that the walk plans with, or null
    failure: its failure, or null
    further_failures: the other failed legs, by number
    events: failures and healings during the walk
    ideal_yaw_change_deg: `--turn` times the duration, including the soft start
    ticks: control periods of the walk
    overruns: late ticks
    standstill_s: how long this program stood still before it stopped the robot, or null
    refused_commands: commands that the guard refused
    positions_doubted: measured positions that the robot cannot have reached
    servo_link: messages of a servo board: received, lost, late, malformed, not sent; null without one
    tick_us: time per tick in microseconds: `p50`, `p99`, `max`
    realtime_factor: seconds walked per second of computation
    backend: the backend of the walk
    sensors: what the robot measures, and a simulation simulates
    sensors_simulated_only: of those, the ones that the robot lacks (`--all-sensors`)
    robot: the robot's name
    world: the simulated world, or null
    seed: the seed
    recording: the file of the recording, or null
    policy: `name`, `contract`: where it was read, `velocity_body`: commanded, `inferences`, `inference_us`:
        their durations, `saturated`: share of them with an action at a limit, by joint; null without a policy
    options: the options that differ from their defaults
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.world import DEFAULT_WORLD, World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial_plan import TrialPlan
from hexctl.robot.configs import shipped_text
from hexctl.robot.failure import FailureEvent, failures_json
from hexctl.runs.run_spec import RunSpec


def gait_values(spec: RunSpec, plan: TrialPlan) -> dict[str, Any]:
    """The gait of a plan, with its name in the spec."""
    gait = plan.gait
    return {
        "name": spec.gait_text,
        "slots": list(gait.slots),
        "code": gait.code(plan.failed_legs),
        "posture": gait.posture.to_dict(),
        "swing_share": gait.swing_share,
        "phases": None if gait.phases is None else list(gait.phases),
        "then": [str(change) for change in spec.then],
    }


def failure_values(plan: TrialPlan, events: Sequence[FailureEvent], until_s: float) -> dict[str, Any]:
    """Failures of a plan, and those of events before a time of the walk."""
    in_order = sorted(events, key=lambda event: event.at_s)
    return {
        **failures_json(plan.failures),
        "events": [str(event) for event in in_order if event.at_s < until_s],
    }


def tick_values(guard: Guard, log: TickLog, wall_s: float) -> dict[str, Any]:
    """Timing of the ticks of a walk, which took `wall_s` of the wall clock, and counters of the guard."""
    work_us = log["work_s"] * 1e6  # (ticks,)
    quantiles = np.percentile(work_us, [50, 99, 100]) if len(log) else np.zeros(3)
    return {
        "ticks": len(log),
        "overruns": guard.clock.overruns,
        "standstill_s": None if guard.standstill is None else round(guard.standstill.duration_s, 1),
        "refused_commands": guard.counters.refused,
        "positions_doubted": guard.positions.doubted,
        "servo_link": guard.link_counts or None,
        "tick_us": dict(zip(("p50", "p99", "max"), (round(float(q), 1) for q in quantiles), strict=True)),
        "realtime_factor": round(len(log) * PERIOD_S / wall_s, 2) if wall_s > 0 else None,
    }


def world_text(spec: RunSpec) -> str | None:
    """Name of the world of a simulation in this process, or None."""
    if not spec.simulated:
        return None
    world = spec.world
    return "custom" if isinstance(world, World) else shipped_text("worlds", world or DEFAULT_WORLD)


def events_seen(log: TickLog) -> list[FailureEvent]:
    """Failures and healings of a remote simulation during the link; those before the walk at its start."""
    if log.walk_from is None:
        return []
    times_s, last = log["time_s"], len(log) - 1
    changes = [change for change in log.leg_changes if change.by == "world"][1:]
    return [
        FailureEvent(
            at_s=round(max(0.0, float(times_s[min(change.row, last)] - times_s[log.walk_from])), 3),
            leg=leg,
            failure=failure,
        )
        for change in changes
        for leg, failure in change.differences
    ]
