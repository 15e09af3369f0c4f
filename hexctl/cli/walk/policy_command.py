"""`hexctl policy`: draft, show and check the contract of a trained policy."""

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from hexctl.backends.robot_options import ServosOptions
from hexctl.cli.console import BAD_INPUT, print_result
from hexctl.cli.settings import Commands
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import number, with_options
from hexctl.control.trial_plan import DURATION_S

policy = Commands()

FileArgument = Annotated[Path, typer.Argument(metavar="FILE", help="Network, an ONNX file.")]

#: Options of robots that only matter when they walk.
_BUT = ("backend", "port", "failed_leg", "failure", "seed", "world")


@policy.command("new")
def draft(file: FileArgument) -> None:
    """Write FILE.yaml: what the network and its files say, and a question mark for the rest."""
    from hexctl.control.policy.draft import draft_of, draft_path
    from hexctl.control.policy.onnx_network import OnnxFile
    from hexctl.files import write_new

    path = draft_path(file)
    write_new(path, draft_of(OnnxFile.read(file)), "FILE")
    print_result(str(path), f"next: fill it in, then hexctl policy show {shlex.quote(str(file))}")


@policy.command("show")
@with_options(ServosOptions, but=_BUT)
def show(asked: dict[str, Any], file: FileArgument, as_json: JsonOption = False) -> None:
    """Print the contract of a policy against a robot, line by line, and what does not match."""
    from hexctl.control.policy.description import describe
    from hexctl.control.policy.policy import Policy

    found = describe(Policy.load(file), _robot(asked))
    if as_json:
        print_result(found)
    else:
        from hexctl.cli.render.policy_output import contract_parts

        print_result(*contract_parts(found))
    if found["problems"]:
        raise typer.Exit(BAD_INPUT)


@policy.command("check")
@with_options(ServosOptions, but=_BUT)
def check(
    asked: dict[str, Any],
    file: FileArgument,
    duration_s: Annotated[
        float | None, number("--duration", DURATION_S, "Seconds to walk, {}. (default: 10)")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Walk a policy for ten seconds in simulation, and print what looks wrong."""
    from hexctl.control.policy.policy import Policy
    from hexctl.runs.policy_check import check_policy
    from hexctl.runs.run_spec import RunSpec

    spec = RunSpec(duration_s=duration_s or 10.0)
    found = check_policy(Policy.load(file), _robot(asked), spec)
    if as_json:
        print_result(found.to_dict())
    else:
        from hexctl.cli.render.policy_output import check_parts

        print_result(*check_parts(found, file))
    if found.findings:
        raise typer.Exit(BAD_INPUT)


def _robot(asked: dict[str, Any]) -> Any:
    from dataclasses import replace

    from hexctl.robot.loader import load_robot
    from hexctl.robot.sensors import SENSORS

    robot = load_robot(asked["robot"])
    return replace(robot, sensors=SENSORS) if asked["all_sensors"] else robot
