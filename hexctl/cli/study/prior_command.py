"""`hexctl prior`: build what bayes believes, and look at it."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.console import print_note, print_result
from hexctl.cli.options.failure import ALL_LEGS, KIND_HELP, LegsOption
from hexctl.cli.options.output import DaskOption, JobsOption, JsonOption
from hexctl.cli.options.robot import RobotOption
from hexctl.cli.options.walk import SELF_ROTATION_HELP
from hexctl.cli.progress import StudyProgress, interruptible
from hexctl.cli.settings import Commands, runs_folder
from hexctl.cli.values import choice, given, listed, number, refuse_given, with_values
from hexctl.control.trial_plan import SelfRotation
from hexctl.errors import InputError
from hexctl.options import Range

if TYPE_CHECKING:
    from hexctl.adapt.sessions.search_session import SessionSpec

WORLDS = Range(low=2, high=1024, whole=True)
PriorHold = Literal["none", "heading", "line"]
DIRECTIONS = Range(low=1, high=12, whole=True)
CODES = Range(low=0, high=11, whole=True)
PRIOR_DURATION_S = Range(low=6, unit="s")

prior = Commands(
    help="Make and show priors: what hexctl adapt believes before its first trial.", no_args_is_help=True
)


#: Options of `prior build` that say something of a repertoire.
FOR_REPERTOIRE = (
    *("--repertoire", "--robot", "--worlds", "--directions", "--codes", "--pairs", "--family"),
    *("--out", "--jobs", "--dask", "--json"),
)


@prior.command()
def build(
    context: typer.Context,
    robot: RobotOption = "ant",
    repertoire: Annotated[
        bool,
        typer.Option(
            "--repertoire",
            help="Build a repertoire instead: how the robot walks on after each failure of a leg, a joint or "
            "two legs, with each of a few gaits, for hexctl run --recover.",
        ),
    ] = False,
    worlds: Annotated[
        int | None,
        number(
            "--worlds",
            WORLDS,
            "Worlds that each failed leg's gaits walk in, {}; with --repertoire of each family, up to 16. "
            "(default: 16, with --repertoire 4)",
        ),
    ] = None,
    directions: Annotated[
        int | None,
        number(
            "--directions",
            DIRECTIONS,
            "Directions of travel of a repertoire, a whole number {}: 1, 2, 4, 6, 8 or 12. (default: 12)",
        ),
    ] = None,
    codes: Annotated[
        int | None,
        number(
            "--codes",
            CODES,
            "Next codes by the static margin in a repertoire, and as many at random, a whole number {}. "
            "(default: 2)",
        ),
    ] = None,
    pairs: Annotated[
        str | None,
        typer.Option(
            "--pairs",
            help="How both legs of the pairs of a repertoire fail, with commas, or none. "
            "(default: locked,limp,missing)",
            show_default=False,
        ),
    ] = None,
    legs: LegsOption = ALL_LEGS,
    failure: Annotated[
        str, typer.Option("--failure", autocompletion=completion.kinds, help=KIND_HELP)
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
        str | None,
        typer.Option(
            "--family",
            autocompletion=completion.families,
            help="Family of worlds to draw from: randomised, or a path to a YAML file; with --repertoire "
            "several with commas. (default: randomised, with --repertoire transfer,real)",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="File to write, .npz. (default: runs/priors/ROBOT-FAILURE-ROTATION-SECONDS[-HOLD].npz, with "
            "--repertoire runs/repertoires/ROBOT.npz)",
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
    from hexctl.adapt.prior.prior_files import PRIORS, describe_prior
    from hexctl.backends.sim.world import load_randomization
    from hexctl.control.trial_plan import AUTO_ROTATION, suited_rotation
    from hexctl.robot.failure_grammar import parse_legs
    from hexctl.robot.loader import load_robot
    from hexctl.study.prior_building import PriorPlan, build_prior, prior_file_name

    own = {"--directions": directions, "--codes": codes, "--pairs": pairs}
    if repertoire:
        others = {flag: value for flag, value in given(context).items() if flag not in FOR_REPERTOIRE}
        refuse_given(others, "without --repertoire, which walks all failures")
        made = _repertoire(robot, worlds, family, own, out, jobs, dask)
        print_result(json.dumps(made) if as_json else _repertoire_line(made))
        return
    refuse_given(own, "with --repertoire")
    family = family or "randomised"
    plan = PriorPlan(
        robot=load_robot(robot),
        family=load_randomization(family),
        worlds=worlds or 16,
        legs=parse_legs(legs, "--legs"),
        failure=failure,
        self_rotation=suited_rotation(self_rotation or AUTO_ROTATION, hold, chosen_gait=True),
        hold=hold,
        duration_s=duration,
    )
    path = out or runs_folder() / PRIORS / prior_file_name(plan, family)
    with interruptible(lambda cache: cache.count(plan.specs())), StudyProgress() as progress:
        build_prior(plan, path, jobs=jobs, dask=dask, progress=progress)
    text = f"prior: {path} ({path.stat().st_size / 1e3:.0f} kB)"
    print_result(json.dumps({"prior": str(path), **describe_prior(path)}) if as_json else text)


def _repertoire(
    robot: str,
    worlds: int | None,
    family: str | None,
    own: Mapping[str, Any],
    out: Path | None,
    jobs: int | None,
    dask: str | None,
) -> dict[str, Any]:
    """Build a repertoire, and describe it."""
    from hexctl.backends.sim.world import load_randomization
    from hexctl.control.monitor.repertoire_store import REPERTOIRES, describe_repertoire
    from hexctl.robot.loader import load_robot
    from hexctl.study.repertoire.building import build_repertoire, repertoire_file_name
    from hexctl.study.repertoire.repertoire_plan import RepertoirePlan
    from hexctl.study.repertoire.repertoire_walks import repertoire_cache

    asked: dict[str, Any] = {"worlds": worlds, "directions": own["--directions"], "codes": own["--codes"]}
    if own["--pairs"] is not None:
        asked["pair_failures"] = () if own["--pairs"] == "none" else listed(own["--pairs"])
    plan = RepertoirePlan(
        robot=load_robot(robot),
        families={name: load_randomization(name) for name in listed(family or "transfer,real")},
        **with_values(**asked),
    )
    plan.check()
    path = out or runs_folder() / REPERTOIRES / repertoire_file_name(plan)
    counted = interruptible(lambda cache: repertoire_cache(cache).count(plan.walked()), "walks")
    with counted, StudyProgress() as progress:
        build_repertoire(plan, path, jobs=jobs, dask=dask, progress=progress)
    return {"repertoire": str(path), **describe_repertoire(path)}


@prior.command()
def show(
    file: Annotated[
        str | None, typer.Argument(help="Prior to show, an .npz file. (default: all there are)")
    ] = None,
    repertoire: Annotated[bool, typer.Option("--repertoire", help="Show repertoires instead.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Say what priors are for: robot, failure, trial, worlds."""
    from hexctl.adapt.prior.prior_files import describe_prior, list_priors, named_prior, prior_folders

    if repertoire:
        shown = _repertoires(file)
        lines = "\n".join(_repertoire_line(one) for one in shown) or "no repertoires yet"
        print_result(json.dumps(shown) if as_json else lines)
        return
    if file is not None:
        path = named_prior(file, prior_folders(runs_folder()))
        described = [{"prior": str(path), **describe_prior(path)}]
    else:
        described = list_priors(
            runs_folder(), on_damaged=lambda error: print_note(f"hexctl: passed over: {error}")
        )
    if as_json:
        print_result(json.dumps(described))
    else:
        print_result("\n".join(_line(one) for one in described) or "no priors yet")


def _repertoires(file: str | None) -> list[dict[str, Any]]:
    """Describe one repertoire, by its path or name, or all that `hexctl run --recover` would search."""
    from hexctl.control.monitor.repertoire_store import describe_repertoire, repertoire_files

    if file is not None:
        named = (path for path in repertoire_files(runs_folder()) if file in (path.name, path.stem))
        path = Path(file) if Path(file).is_file() else next(named, Path(file))
        return [{"repertoire": str(path), **describe_repertoire(path)}]
    described = []
    for path in repertoire_files(runs_folder()):
        try:
            described.append({"repertoire": str(path), **describe_repertoire(path)})
        except InputError as error:
            print_note(f"hexctl: passed over: {error}")
    return described


def _repertoire_line(described: dict[str, Any]) -> str:
    pairs = f", pairs {', '.join(described['pairs'])}" if described["pairs"] else ""
    directions = "straight ahead" if described["directions"] == 1 else f"{described['directions']} directions"
    others, situations = described["others"], described["situations"]
    share = f"all {situations}" if others == situations else f"{others} of {situations}"
    return (
        f"{described['repertoire']}: {described['robot']}, legs {', '.join(described['legs'])}{pairs}, "
        f"{directions}, {described['walks']} walks of each gait; another than the safest is best in {share} "
        "situations"
    )


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
    from hexctl.study.prior_building import PriorPlan

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
