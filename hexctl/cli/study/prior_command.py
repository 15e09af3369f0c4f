"""`hexctl prior`: build and show the priors of bayes."""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from hexctl.cli.console import print_result
from hexctl.cli.output_options import JsonOption
from hexctl.cli.progress import finish
from hexctl.cli.results.left_out import LeftOut
from hexctl.cli.settings import Commands, runs_folder
from hexctl.cli.signature import with_options
from hexctl.cli.values import is_typed
from hexctl.errors import InputError
from hexctl.study.priors.prior_options import OF_PRIOR, PriorOptions

#: Describes a file as JSON values; raises InputError for a damaged one.
Describe = Callable[[Path], dict[str, Any]]

prior = Commands(
    help="Make and show priors: what hexctl adapt believes before its first trial.", no_args_is_help=True
)


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
        print_result(json.dumps(made))
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
    """Say what priors are for: robot, failure, trial, worlds.

    Damaged files are named on stderr, with exit code 3; the others are shown.
    """
    left_out = LeftOut()
    paths, describe = (_repertoires if repertoire else _priors)(file)
    shown = list(_described("repertoire" if repertoire else "prior", paths, describe, file, left_out))
    line, none = (repertoire_line, "no repertoires yet") if repertoire else (prior_line, "no priors yet")
    print_result(json.dumps(shown) if as_json else "\n".join(map(line, shown)) or none)
    raise typer.Exit(left_out.code())


def _described(
    kind: str, paths: Iterable[Path], describe: Describe, named: str | None, left_out: LeftOut
) -> Iterator[dict[str, Any]]:
    """Descriptions of files; damaged ones are left out, but one that was named raises InputError."""
    for path in paths:
        try:
            yield {kind: str(path), **describe(path)}
        except InputError as error:
            if named is not None:
                raise
            left_out.name(error)


def _priors(file: str | None) -> tuple[Sequence[Path], Describe]:
    from hexctl.adapt.prior.prior_files import describe_prior, named_prior, prior_files, prior_folders

    folders = prior_folders(runs_folder())
    return prior_files(folders) if file is None else [named_prior(file, folders)], describe_prior


def _repertoires(file: str | None) -> tuple[Sequence[Path], Describe]:
    from hexctl.control.monitor.repertoire_store import (
        describe_repertoire,
        named_repertoire,
        repertoire_files,
    )

    folder = runs_folder()
    return repertoire_files(folder) if file is None else [named_repertoire(file, folder)], describe_repertoire


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
