"""`hexctl study`: the paper's experiments."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli.options import JsonOption, RobotOption


def study(
    legs: Annotated[str, typer.Option("--legs", help="Failed legs, such as 2,5.")] = "1,2,3,4,5,6",
    optimizers: Annotated[
        str,
        typer.Option(
            "--optimizers", help="Of pso, psosp, dps, debest, derand, random, exhaustive, or your own."
        ),
    ] = "pso,psosp,dps,debest,derand,random",
    runs: Annotated[int, typer.Option("--runs", help="Seeded runs of each optimizer on each leg.")] = 30,
    budget: Annotated[int, typer.Option("--budget", help="Evaluations of a run.")] = 120,
    duration: Annotated[float, typer.Option("--duration", help="Seconds that each gait walks.")] = 30.0,
    robot: RobotOption = "ant",
    world: Annotated[str, typer.Option("--world", help="As in hexctl run.")] = "flat",
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder for the report. (default: runs/study-TIME)", show_default=False),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", help="Threads of each batch of gaits. (default: all cores; with --dask 1)"),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option("--dask", help="Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of searches and simulation.")] = 0,
    as_json: JsonOption = False,
) -> None:
    """Walk all 120 gaits of each failed leg, search them with all optimizers, and report.

    Gaits are walked once and kept under runs/study-cache; Ctrl-C, then the same command goes on.
    """
    from hexctl.cli.simulating import listed, listed_legs
    from hexctl.cli.studying import StudyRequest, execute

    request = StudyRequest(
        legs=listed_legs(legs),
        optimizers=listed(optimizers),
        runs=runs,
        budget=budget,
        duration_s=duration,
        robot=robot,
        world=world,
        out=out,
        jobs=jobs,
        dask=dask,
        seed=seed,
        as_json=as_json,
    )
    raise typer.Exit(execute(request))
