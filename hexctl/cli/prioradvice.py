"""How to get a prior for trials that have none."""

from hexctl.adapt.session import SessionSpec
from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.study.prior import PriorPlan


def how_to_get_one(spec: SessionSpec) -> str:
    """Return the command that makes a prior for a session's trials, as the end of a sentence.

    Empty where none can be made: for other objectives and headings, short walks, failures with details.
    """
    if spec.objective != "final" or spec.heading_deg:
        return ""
    plan = PriorPlan(
        robot=load_robot(spec.robot),
        family=load_randomization("randomised"),
        failure=spec.failure,
        self_rotation=spec.self_rotation,
        duration_s=spec.duration_s,
    )
    try:
        plan.check()
    except InputError:
        return ""
    asked = {
        "robot": spec.robot,
        "failure": spec.failure,
        "self-rotation": spec.self_rotation,
        "duration": f"{spec.duration_s:g}",
    }
    usual = {"robot": "ant", "failure": "locked", "self-rotation": "rear", "duration": "30"}
    options = "".join(f" --{name} {value}" for name, value in asked.items() if value != usual[name])
    return f"; this makes one: hexctl prior build{options}"
