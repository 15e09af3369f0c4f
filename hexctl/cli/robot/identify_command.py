"""`hexctl identify`: the servos and the trunk of a robot from its own motions."""

import math
import shlex
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.backends.robot_options import RecordedOptions
from hexctl.cli.console import INTERRUPTED, code_of, print_message, print_result
from hexctl.cli.progress import StatusLine, interruptible
from hexctl.cli.settings import is_said
from hexctl.cli.shared_options import JsonOption, record_folder
from hexctl.cli.signature import with_options
from hexctl.errors import InputError, MissingExtraError
from hexctl.identify.options import WITHOUT_LOGS, IdentifyOptions, picture_of
from hexctl.identify.parameters import PARAMETERS, RobotValues

if TYPE_CHECKING:
    from hexctl.identify.identification import Identification
    from hexctl.identify.robot_log import RobotLog

#: Error of the result above that before from which nothing was identified.
WORSE_DEG = 0.02

#: Left error above which a warning is printed: free legs leave 0.1 to 0.2 degrees, feet on a floor 0.8.
POOR_DEG = 0.5

#: Left error of a run on a bench, as a share of its motion, above which a warning is printed.
POOR_SHARE = 0.2

#: Shares of late readings that are printed, and that change values: with 10 % they change by up to 3 %.
SEEN_SHARE, WRONG_SHARE = 0.005, 0.1

CONSENT = (
    "The legs of a robot on a stand move for {:.0f} s, by up to {:.0f} degrees to either side, at up to 90 % "
    "of their speed limits."
)


@with_options(IdentifyOptions, rare=("record",))
def identify(
    given: dict[str, Any],
    context: typer.Context,
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[LOG...]",
            help="Recordings (.rrd) of the robot, or runs (.json) of one servo that swings a mass. Without "
            "any, the robot moves its legs on a stand, after a question.",
        ),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Move the robot without a question.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Identify the servos and the trunk of a robot from its motions.

    The command finds stiffness, damping, inertia, friction, torque, play and dead time: simulated servos are
    changed until their joints move as those of the log did. Mass and centre of the trunk need a log of a
    walk. The geometry and the masses of the legs are those of the robot file. A simulated robot is in the
    world stand. Exit codes: 0 done, 2 bad input, 3 fault of robot or link, 4 stopped, 130 interrupted.
    """
    options = IdentifyOptions(**given, logs=logs)
    options.check()
    options.check_output()
    if logs and yes:
        raise InputError(f"--yes: {WITHOUT_LOGS}")
    # A recording without --robot is of a robot that is not the default one.
    next_time = options if is_said(context, "robot") or not logs else replace(options, robot="ROBOT")
    paths = list(logs or ())
    if not paths:
        paths = [_moved(given, yes=yes)]
    elif options.output is not None and not is_said(context, "robot"):
        raise InputError("--output requires --robot with logs: the robot file that is copied and changed")
    own_robot = None
    if is_said(context, "robot") and paths[0].suffix == ".rrd":
        from hexctl.robot.loader import load_robot

        own_robot = load_robot(str(options.robot))
    print_message("the search takes some minutes; Ctrl-C keeps the logs")
    try:
        found = _identified(paths, own_robot, options)
    except KeyboardInterrupt:
        print_message(f"interrupted; the logs are kept; continue with: {_again(paths, next_time)}")
        raise typer.Exit(INTERRUPTED) from None
    _print_doubts(found)
    if not as_json:
        print_result(*_report(found))
    try:
        written = _write(found, options, paths)
    except OSError as error:
        raise InputError(
            f"--output: {options.output} cannot be written ({error.strerror}); allowed: a new file; "
            f"continue with: {_again(paths, replace(options, output='FILE.yaml'))}"
        ) from error
    if as_json:
        print_result(found.to_dict() | {"output": written})
    elif written is not None:
        print_result("", f"wrote {written}")
    else:
        print_result("", f"next: {_again(paths, replace(next_time, output='FILE.yaml'))}")


def _print_doubts(found: "Identification") -> None:
    of_robot = isinstance(found.fit.values, RobotValues)
    if of_robot:
        from hexctl.identify.robot_log import RobotLog

        for log in found.replays:
            if isinstance(log, RobotLog) and (late := _late_readings(log)):
                print_message(f"{log.name}: {late}")
    errors = found.to_dict()["error_deg"]
    if errors["after"] > errors["before"] + WORSE_DEG:
        raise InputError(
            f"LOG: got motions that the result fits worse ({errors['after']:.2f} deg) than the start "
            f"({errors['before']:.2f} deg), nothing was written; allowed: motions of working legs, and rad, "
            "m, kg and s on a bench"
        )
    if of_robot and (left_deg := _left_deg(found)) > POOR_DEG:
        print_message(
            f"a poor fit, {left_deg:.2f} deg are left: the values may be wrong; has a leg failed? On a stand "
            "no foot may touch anything, and the robot file must have the right masses and lengths"
        )
    if not of_robot and (share := _left_share(found)) > POOR_SHARE:
        print_message(
            f"a poor fit, {100 * share:.0f} % of the motion is left: the values may be wrong; the runs must "
            "count in rad, m, kg and s, not in degrees, mm or grams"
        )


def _left_share(found: "Identification") -> float:
    """Error of the runs on a bench as a share of their motion, the largest; 0 without one."""
    from hexctl.identify.bench_run import BenchRun

    errors_rad = {**found.fit.after_rad, **found.judged_rad}
    moved_rad = {
        one.name: float(one.measured_rad.std()) for one in found.replays if isinstance(one, BenchRun)
    }
    return max((errors_rad[name] / moved for name, moved in moved_rad.items() if moved > 0), default=0.0)


def _late_readings(log: "RobotLog") -> str:
    """Figures of a log with late or missing readings, and their effect; empty for a good log."""
    shares = {
        "readings of moving joints repeat the last one": log.repeated_share,
        "ticks have no reading": log.skipped_share,
    }
    parts = [f"{100 * share:.1f} % of the {what}" for what, share in shares.items() if share > SEEN_SHARE]
    if log.stale_s:
        parts.append(f"readings stood still for {log.stale_s:.2g} s of the motion")
    if not parts:
        return ""
    effect = "values change little. For a picture without jumps, record again"
    if log.stale_s or max(shares.values()) > WRONG_SHARE:
        effect = "values may be wrong. Record again"
    return f"{' and '.join(parts)}: {effect}, with a faster link or a less busy computer"


def _again(paths: list[Path], options: IdentifyOptions) -> str:
    """Command that identifies the same logs."""
    gain = [] if options.p_gain is None else ["--p-gain", f"{options.p_gain:g}"]
    output = [] if options.output is None else ["-o", str(options.output)]
    return shlex.join(["hexctl", "identify", *map(str, paths), "--robot", str(options.robot), *gain, *output])


def _moved(given: dict[str, Any], *, yes: bool) -> Path:
    """Recording of the motions on the stand."""
    from hexctl.cli.prompts import ask_consent
    from hexctl.cli.render.stop_reasons import why_in_words
    from hexctl.cli.walk.connected_run import check_commanded, clear_command, connected
    from hexctl.identify.stand_motions import MOST_RAD
    from hexctl.identify.stand_run import IdentificationRun
    from hexctl.runs.run_spec import RunSpec

    where = {field.name: given[field.name] for field in fields(RecordedOptions) if field.name in given}
    run = IdentificationRun(RunSpec(**where, record_folder=record_folder(where["record"], no_record=False)))
    clear = clear_command(run.spec)
    ask_consent(CONSENT.format(run.motions_s, math.degrees(MOST_RAD)), yes=yes or run.spec.simulated)
    with connected(run) as interrupt:
        print_message(f"the legs move for {run.motions_s:.0f} s; Ctrl-C stops")
        done = run.walk(stop_requested=interrupt.requested)
        check_commanded(done.outcome)
        if interrupt.requested() or done.trial.status != "ok":
            why = " by Ctrl-C" if interrupt.requested() else why_in_words(done.trial.stopped, clear=clear)
            again = "the same command" if run.spec.record is None else "another --record"
            print_message(f"stopped{why}; nothing was identified; {again} begins again")
            raise typer.Exit(INTERRUPTED if interrupt.requested() else code_of(done.trial))
    if done.recording_error is not None:
        raise done.recording_error
    if done.recording is None:
        raise InputError("--record: got none; allowed: a new file, which the identification reads")
    print_message(f"recorded {done.recording}")
    return done.recording


def _identified(paths: list[Path], robot: Any, options: IdentifyOptions) -> "Identification":
    from hexctl.identify.identification import identify as identify_servos

    with interruptible(), StatusLine() as line:

        def show(stage: str, step: int, error_rad: float) -> None:
            line.show(f"search, {stage}: step {step + 1}, error {math.degrees(error_rad):.3f} deg")

        return identify_servos(paths, robot=robot, p_gain=options.p_gain, on_step=show)


def _left_deg(found: "Identification") -> float:
    """Largest error of the logs of a robot on a stand; 0 without one."""
    from hexctl.identify.robot_log import RobotLog

    of_stand = [
        found.fit.after_rad[one.name] for one in found.replays if isinstance(one, RobotLog) and one.on_stand
    ]
    return math.degrees(max(of_stand, default=0.0))


def _write(found: "Identification", options: IdentifyOptions, paths: list[Path]) -> str | None:
    if options.output is None:
        return None
    from hexctl.identify.identification_picture import draw_identification
    from hexctl.identify.identified_file import write_identified
    from hexctl.robot.loader import load_robot

    output = Path(options.output)
    write_identified(str(options.robot), found, output)
    before = None if paths[0].suffix == ".json" else RobotValues.of(load_robot(str(options.robot)))
    try:
        draw_identification(found, before, picture_of(output))
    except (MissingExtraError, InputError) as error:
        print_message(f"no picture: {error}")
        return str(output)
    return f"{output} and {picture_of(output)}"


def _remark(found: "Identification", name: str) -> str:
    """Limit of the search that a known value has, or what else it depends on or changes."""
    one, values = found.fit.estimates[name], found.fit.values
    if one.value + one.deviation >= PARAMETERS[name].high:
        return "at the limit of the search"
    if not isinstance(values, RobotValues):
        return ""
    if name == "max_torque_nm" and math.isfinite(values.no_load_speed_rad_s):
        return "no_load_speed_deg_s changes by the same share"
    return "includes the delay of the link" if name == "dead_time_s" else ""


def _report(found: "Identification") -> list[Any]:
    from hexctl.cli.render.tables import label_table, plain_table

    table = plain_table("parameter", "value", "±", "unit", "")
    for name, one in found.estimates.items():
        said = _remark(found, name) if one.known else "not determined; the file keeps its value"
        table.add_row(name, f"{one.value:.4g}", f"{one.deviation:.2g}", one.unit, said)
    for name in found.not_seen:
        table.add_row(name, "", "", "", "needs a log of a walk")
    errors = found.to_dict()["error_deg"]
    rows = [("mean error before", f"{errors['before']:.2f} deg"), ("now", f"{errors['after']:.2f} deg")]
    if errors["judged"] is not None:
        rows.append(("on runs not fitted", f"{errors['judged']:.2f} deg"))
    return [table, "", label_table(rows)]
