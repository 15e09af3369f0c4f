"""`hexctl prior`: build what bayes believes, and look at it."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.console import RUNS, print_note, print_result
from hexctl.cli.options import (
    ALL_LEGS,
    FAILURE_HELP,
    SELF_ROTATION_HELP,
    DaskOption,
    JobsOption,
    JsonOption,
    LegsOption,
    Range,
    RobotOption,
    SelfRotation,
    choice,
    listed_legs,
    number,
)
from hexctl.cli.progress import StudyProgress, interruptible
from hexctl.errors import InputError

if TYPE_CHECKING:
    from hexctl.adapt.session import SessionSpec

WORLDS = Range(low=2, high=1024, whole=True)
PriorHold = Literal["none", "heading", "line"]
PRIOR_DURATION_S = Range(low=6, unit="s")

prior = typer.Typer(
    help="Make and show priors: what hexctl adapt believes before its first trial.", no_args_is_help=True
)


@prior.command()
def build(
    robot: RobotOption = "ant",
    worlds: Annotated[
        int, number("--worlds", WORLDS, "Worlds that each failed leg's gaits walk in, {}.")
    ] = 16,
    legs: LegsOption = ALL_LEGS,
    failure: Annotated[
        str, typer.Option("--failure", autocompletion=completion.failures, help=FAILURE_HELP)
    ] = "locked",
    self_rotation: Annotated[
        SelfRotation | None,
        choice(
            "--self-rotation",
            SelfRotation,
            f"{SELF_ROTATION_HELP} (default: rear, but none with --hold line)",
        ),
    ] = None,
    hold: Annotated[
        PriorHold,
        choice(
            "--hold",
            PriorHold,
            "What the walks hold by feedback; with line or heading the prior is of their speed, cost, tilt "
            "and steadiness, with none of where they end.",
        ),
    ] = "none",
    duration: Annotated[
        float, number("--duration", PRIOR_DURATION_S, "Seconds that each gait walks, {}, in steps of 2.")
    ] = 30.0,
    family: Annotated[
        str,
        typer.Option(
            "--family",
            autocompletion=completion.families,
            help="Family of worlds to draw from: randomised, or a path to a YAML file.",
        ),
    ] = "randomised",
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="File to write, .npz. (default: runs/priors/ROBOT-FAILURE-ROTATION-SECONDS[-HOLD].npz)",
            show_default=False,
        ),
    ] = None,
    jobs: JobsOption = None,
    dask: DaskOption = None,
    as_json: JsonOption = False,
) -> None:
    """Walk all 120 gaits of each failed leg in many plausible worlds, and keep the outcomes.

    On two cores a leg and world take about 20 seconds. Gaits walked are kept under runs/study-cache; Ctrl-C,
    then the same command continues. hexctl adapt finds the prior by itself.
    """
    from hexctl.adapt.prior.find import PRIORS, describe_prior
    from hexctl.backends.sim.world import load_randomization
    from hexctl.control.plan import AUTO_ROTATION, suited_rotation
    from hexctl.robot.loader import load_robot
    from hexctl.study.prior import PriorPlan, build_prior, prior_file_name

    plan = PriorPlan(
        robot=load_robot(robot),
        family=load_randomization(family),
        worlds=worlds,
        legs=listed_legs(legs),
        failure=failure,
        self_rotation=suited_rotation(self_rotation or AUTO_ROTATION, hold, chosen_gait=True),
        hold=hold,
        duration_s=duration,
    )
    path = out or RUNS / PRIORS / prior_file_name(plan, family)
    with interruptible(lambda cache: cache.count(plan.specs())), StudyProgress() as progress:
        build_prior(plan, path, jobs=jobs, dask=dask, progress=progress)
    text = f"prior: {path} ({path.stat().st_size / 1e3:.0f} kB)"
    print_result(json.dumps({"prior": str(path), **describe_prior(path)}) if as_json else text)


@prior.command()
def show(
    file: Annotated[
        str | None, typer.Argument(help="Prior to show, an .npz file. (default: all there are)")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what priors are for: robot, failure, trial, worlds."""
    from hexctl.adapt.prior.find import describe_prior, list_priors, named_prior, prior_folders

    if file is not None:
        path = named_prior(file, prior_folders(RUNS))
        described = [{"prior": str(path), **describe_prior(path)}]
    else:
        described = list_priors(RUNS, on_damaged=lambda error: print_note(f"hexctl: passed over: {error}"))
    if as_json:
        print_result(json.dumps(described))
    else:
        print_result("\n".join(_line(one) for one in described) or "no priors yet")


def _line(described: dict[str, Any]) -> str:
    legs = ",".join(str(leg) for leg in described["legs"])
    return (
        f"{described['prior']}: {described['robot']}, legs {legs} {described['failure']}, self-rotation "
        f"{described['self_rotation']}, {described['duration_s']:g} s, {described['worlds']} worlds a leg"
        f"{_kind(described)}"
    )


def _kind(described: dict[str, Any]) -> str:
    """What else is worth saying of a prior: its hold and its objectives, or a missing stance."""
    if "scores" in described:
        return f", hold {described['hold']}: {', '.join(described['scores'])}"
    return "" if described["stances"] else ", without stances"


def how_to_build_prior(spec: "SessionSpec") -> str:
    """Command that makes a prior for a session's trials, as the end of a sentence.

    Empty where none can be made: for other objectives and headings, short walks, failures with details.
    """
    from hexctl.adapt.prior.prior import SCORES
    from hexctl.backends.sim.world import load_randomization
    from hexctl.robot.loader import load_robot
    from hexctl.study.prior import PriorPlan

    hold = "line" if spec.hold == "auto" else spec.hold
    objectives = ("final",) if hold == "none" else SCORES
    if spec.objective not in objectives or spec.heading_deg:
        return ""
    plan = PriorPlan(
        robot=load_robot(spec.robot),
        family=load_randomization("randomised"),
        failure=spec.failure,
        self_rotation=spec.self_rotation,
        duration_s=spec.duration_s,
        hold=hold,
    )
    try:
        plan.check()
    except InputError:
        return ""
    asked = {
        "robot": spec.robot,
        "failure": spec.failure,
        "hold": hold,
        "self-rotation": spec.self_rotation,
        "duration": f"{spec.duration_s:g}",
    }
    usual = {"robot": "ant", "failure": "locked", "hold": "none", "duration": "30"}
    usual["self-rotation"] = "none" if hold == "line" else "rear"
    options = "".join(f" --{name} {value}" for name, value in asked.items() if value != usual[name])
    return f"; this makes one: hexctl prior build{options}"
