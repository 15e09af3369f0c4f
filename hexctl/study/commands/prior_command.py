"""`hexctl prior`: build and show the priors of bayes."""

from typing import Annotated, Any

import typer

from hexctl.adapt.prior.prior_files import describe_prior, list_priors, named_prior, prior_folders
from hexctl.cli.console import LeftOut, print_result
from hexctl.cli.settings import Commands, is_typed, runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.control.monitor.repertoire import describe_repertoire, list_repertoires, named_repertoire
from hexctl.errors import InputError
from hexctl.study.commands.study_progress import finish
from hexctl.study.priors.prior_options import OF_PRIOR, PriorOptions

prior = Commands()


@prior.command()
@with_options(PriorOptions, rare=("duration_s",))
def build(asked: dict[str, Any], context: typer.Context, as_json: JsonOption = False) -> None:
    """Walk all 120 gaits of each failed leg in many plausible worlds, and keep the outcomes.

    On two cores a leg and world take about 20 seconds. Gaits walked are kept under runs/study-cache; Ctrl-C,
    then the same command continues. hexctl adapt finds the prior by itself.
    """
    from hexctl.study.priors.planned_prior import planned_prior

    # Settings are those of priors: a repertoire ignores them, and refuses only typed options.
    unused = [name for name in OF_PRIOR if asked["repertoire"] and not is_typed(context, name)]
    options = PriorOptions(**{name: value for name, value in asked.items() if name not in unused})
    made = finish(planned_prior(options, runs=runs_folder()))
    if as_json:
        print_result(made)
    elif options.repertoire:
        print_result(repertoire_line(made))
    else:
        print_result(f"prior: {made['prior']} ({made['bytes'] / 1e3:.0f} kB)")


@prior.command()
def show(
    file: Annotated[
        str | None, typer.Argument(help="Prior to show, an .npz file. (default: all there are)")
    ] = None,
    repertoire: Annotated[bool, typer.Option("--repertoire", help="Show repertoires instead.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show the robot, failure, trial and worlds of priors.

    Damaged files are named on stderr, with exit code 3; the others are shown.
    """
    left_out = LeftOut()
    try:
        shown = (_repertoires if repertoire else _priors)(file, left_out)
    except InputError as error:
        raise InputError(error.worded(lambda _: "FILE")) from error
    line, none = (repertoire_line, "no repertoires yet") if repertoire else (prior_line, "no priors yet")
    print_result(shown if as_json else "\n".join(map(line, shown)) or none)
    raise typer.Exit(left_out.code())


def _priors(file: str | None, left_out: LeftOut) -> list[dict[str, Any]]:
    if file is None:
        return list_priors(runs_folder(), on_damage=left_out.name)
    path = named_prior(file, prior_folders(runs_folder()))
    return [{"prior": str(path), **describe_prior(path)}]


def _repertoires(file: str | None, left_out: LeftOut) -> list[dict[str, Any]]:
    if file is None:
        return list_repertoires(runs_folder(), on_damage=left_out.name)
    path = named_repertoire(file, runs_folder())
    return [{"repertoire": str(path), **describe_repertoire(path)}]


def prior_line(described: dict[str, Any]) -> str:
    """One line about a prior."""
    legs = ",".join(str(leg) for leg in described["legs"])
    return (
        f"{described['prior']}: {described['robot']}, legs {legs} {described['failure']}, self-rotation "
        f"{described['self_rotation']}, {described['duration_s']:g} s, {described['worlds']} worlds a leg"
        f"{_kind(described)}"
    )


def _kind(described: dict[str, Any]) -> str:
    if "scores" in described:
        return f", hold {described['hold']}: {', '.join(described['scores'])}"
    return "" if described["stances"] else ", without stances"


def repertoire_line(described: dict[str, Any]) -> str:
    """One line about a repertoire."""
    pairs = f", pairs {', '.join(described['pairs'])}" if described["pairs"] else ""
    directions = "straight ahead" if described["directions"] == 1 else f"{described['directions']} directions"
    others, situations = described["others"], described["situations"]
    share = f"all {situations}" if others == situations else f"{others} of {situations}"
    return (
        f"{described['repertoire']}: {described['robot']}, legs {', '.join(described['legs'])}{pairs}, "
        f"{directions}, {described['walks']} walks of each gait; another than the safest is best in {share} "
        "situations"
    )
