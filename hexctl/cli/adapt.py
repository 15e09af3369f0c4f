"""`hexctl adapt`: find a gait for a failed leg."""

from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import (
    DURATION_S,
    FAILED_LEG_HELP,
    HEADING_DEG,
    LEG,
    ROBOT_HELP,
    SEED,
    SEED_HELP,
    SELF_ROTATION_HELP,
    ConnectOption,
    FailureOption,
    InsecureOption,
    JsonOption,
    KeysOption,
    LinkOption,
    Range,
    SelfRotation,
    WorldOption,
    choice,
    number,
)

BUDGET = Range(low=1, high=100_000, whole=True)
REPEATS = Range(low=0, whole=True)
METRES = Range(low=0, above=True, unit="m")


def adapt(
    failed_leg: Annotated[
        int | None,
        number("--failed-leg", LEG, f"{FAILED_LEG_HELP} Needed, unless --resume. (default: none)"),
    ] = None,
    failure: FailureOption = None,
    budget: Annotated[
        int | None, number("--budget", BUDGET, "Most trials to walk, {}. (default: 20)")
    ] = None,
    optimizer: Annotated[
        str | None,
        typer.Option(
            "--optimizer",
            autocompletion=completion.optimizers,
            help="What chooses the next gait: bayes (knows simulated worlds), random, exhaustive, or one of "
            "the paper's pso, psosp, dps, debest, derand; or package.module:Class. "
            "(default: bayes where a prior fits, else random)",
        ),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            "--prior",
            autocompletion=completion.priors,
            help="Prior, what bayes believes before the first trial: auto (made by hexctl prior build, or "
            "shipped), a file, or none. (default: auto)",
        ),
    ] = None,
    early_stop: Annotated[
        bool,
        typer.Option("--early-stop", help="With bayes: end a walk as soon as it is clear that it misses."),
    ] = False,
    objective: Annotated[
        str | None,
        typer.Option(
            "--objective",
            autocompletion=completion.objectives,
            help="What to make small: final, mean or max distance from the line of travel, or progress "
            "(final, per share of the ideal distance walked). (default: final)",
        ),
    ] = None,
    target: Annotated[
        float | None,
        number(
            "--target",
            METRES,
            "Stop once the objective is this small, in metres, {}; bayes once it is 90 % sure. "
            "(default: 0.025 with bayes, else none)",
        ),
    ] = None,
    confirm: Annotated[
        int | None,
        number("--confirm", REPEATS, "Of the budget, trials kept to repeat the best gait, {}. (default: 0)"),
    ] = None,
    count_repeats: Annotated[
        bool,
        typer.Option("--count-repeats", help="Walk a gait again when the optimizer asks for it again."),
    ] = False,
    duration: Annotated[
        float | None,
        number("--duration", DURATION_S, "Seconds that each trial walks, {}. (default: 30)"),
    ] = None,
    heading: Annotated[
        float | None,
        number(
            "--heading",
            HEADING_DEG,
            "Direction of travel in degrees, {}, counter-clockwise from forward. (default: 0)",
        ),
    ] = None,
    self_rotation: Annotated[
        SelfRotation | None,
        choice("--self-rotation", SelfRotation, f"{SELF_ROTATION_HELP} (default: rear)"),
    ] = None,
    backend: Annotated[
        str | None,
        typer.Option(
            "--backend",
            autocompletion=completion.backends,
            help="What moves: sim, zenoh (a robot that hexctl serve puts on the network), mavlink (a servo "
            "board), or package.module:Class for servos of your own. (default: sim)",
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            "--robot",
            autocompletion=completion.robots,
            help=f"{ROBOT_HELP} (default: ant)",
        ),
    ] = None,
    world: WorldOption = None,
    connect: ConnectOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
    arena: Annotated[
        float | None,
        number(
            "--arena",
            METRES,
            "On a robot that stays where a walk ends: the radius in metres, {}, around its place "
            "at the session's start that it is kept in. (default: none, it wanders)",
        ),
    ] = None,
    ask: Annotated[
        bool,
        typer.Option(
            "--ask",
            help="On a robot that does not know where it is: you put it on its mark before each trial and "
            "type in, in metres, where it ended.",
        ),
    ] = False,
    resume: Annotated[
        str | None,
        typer.Option(
            "--resume",
            autocompletion=completion.sessions,
            help="Go on with this session, by its name in hexctl sessions list; --budget lets one whose "
            "budget is spent walk more. (default: begin a new one)",
        ),
    ] = None,
    view: Annotated[
        bool,
        typer.Option(
            "--view",
            help="Show a real robot's trials in Rerun while they go on, and the session at its end.",
        ),
    ] = False,
    no_record: Annotated[bool, typer.Option("--no-record", help="Leave no recordings.")] = False,
    seed: Annotated[
        int | None,
        number("--seed", SEED, f"{SEED_HELP} (default: 0)"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find a gait for a failed leg in few trials; each is kept and recorded.

    A trial walks one of the 120 gaits and is scored by how far off the line it ends. Ctrl-C ends a session,
    --resume goes on with it.
    """
    from hexctl.cli.adapting import check_resumed_alone, execute, new_spec

    options = {
        "robot": robot,
        "backend": backend,
        "world": world,
        "failed_leg": failed_leg,
        "failure": failure,
        "optimizer": optimizer,
        "prior": prior,
        "early_stop": early_stop or None,
        "objective": objective,
        "budget": budget,
        "target_m": target,
        "confirm": confirm,
        "count_repeats": count_repeats or None,
        "duration_s": duration,
        "heading_deg": heading,
        "self_rotation": self_rotation,
        "seed": seed,
        "connect": connect,
        "credentials": str(keys) if keys is not None else None,
        "insecure": insecure or None,
        "link": link,
        "arena_m": arena,
        "ask": ask or None,
    }
    if resume is not None:
        check_resumed_alone(resume, **{**options, "budget": None})
    spec = new_spec(**options) if resume is None else None
    raise typer.Exit(
        execute(spec, resume=resume, budget=budget, record=not no_record, view=view, as_json=as_json)
    )
