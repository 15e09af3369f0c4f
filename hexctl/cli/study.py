"""`hexctl study`: the paper's experiments."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import (
    WORLD_HELP,
    DaskOption,
    JobsOption,
    JsonOption,
    Range,
    RobotOption,
    SeedOption,
    TrialDurationOption,
    number,
)

COUNT = Range(low=1, whole=True)
WORLDS = Range(low=1, high=1000, whole=True)


def study(
    legs: Annotated[str, typer.Option("--legs", help="Failed legs, of 1..6, with commas.")] = "1,2,3,4,5,6",
    transfer: Annotated[
        bool,
        typer.Option(
            "--transfer",
            help="Ask another question: how do all searches do in worlds that no prior has seen.",
        ),
    ] = False,
    optimizers: Annotated[
        str | None,
        typer.Option(
            "--optimizers",
            help="Searches, with commas: of pso, psosp, dps, debest, derand, random, exhaustive, or your "
            "own package.module:Class; with --transfer also "
            "bayes and bayes-early. (default: those six and the bayes ones)",
        ),
    ] = None,
    runs: Annotated[
        int | None,
        number("--runs", COUNT, "Runs of each optimizer on each leg, {}. (default: 30; with --transfer 5)"),
    ] = None,
    budget: Annotated[
        int | None,
        number("--budget", COUNT, "Trials of a run, {}. (default: 120; with --transfer 60)"),
    ] = None,
    worlds: Annotated[
        int | None,
        number("--worlds", WORLDS, "With --transfer, how many worlds, {}. (default: 30)"),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            autocompletion=completion.priors,
            help="With --transfer, what bayes believes: auto or a file. (default: auto)",
        ),
    ] = None,
    duration: TrialDurationOption = 30.0,
    robot: RobotOption = "ant",
    world: Annotated[
        str | None,
        typer.Option(
            "--world",
            autocompletion=completion.worlds,
            help=f"{WORLD_HELP} Not with --transfer. (default: flat)",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for the report, new or empty. (default: runs/study-TIME)",
            show_default=False,
        ),
    ] = None,
    jobs: JobsOption = None,
    dask: DaskOption = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Repeat the paper's experiments: all gaits of each failed leg, all searches, one report.

    Gaits are walked once and kept under runs/study-cache; Ctrl-C, then the same command goes on.
    """
    from hexctl.cli.simulating import listed, listed_legs
    from hexctl.cli.studying import StudyRequest, execute

    request = StudyRequest(
        legs=listed_legs(legs),
        optimizers=None if optimizers is None else listed(optimizers),
        runs=runs,
        budget=budget,
        worlds=worlds,
        prior=prior,
        duration_s=duration,
        robot=robot,
        world=world,
        out=out,
        jobs=jobs,
        dask=dask,
        seed=seed,
        as_json=as_json,
    )
    if transfer:
        from hexctl.cli.transferring import execute_transfer

        raise typer.Exit(execute_transfer(request))
    raise typer.Exit(execute(request))
