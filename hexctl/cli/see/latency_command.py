"""`hexctl see latency`: how late a camera's pictures come, by a twist of the robot."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hexctl.cli.output_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.vision.camera_options import CameraOptions

if TYPE_CHECKING:
    from hexctl.vision.latency_trial import LatencyTrial, TwistAhead


@with_options(CameraOptions, rare=("place",))
def latency(options: dict[str, Any], as_json: JsonOption = False) -> None:
    """Measure how late a camera's pictures come: the standing robot twists once and is watched.

    Its feet stay in place, and nothing else may drive it meanwhile. Ctrl-C takes the twist back. Exit codes:
    0 done, 2 bad input, an invisible tag or too little motion, 3 fault of robot, link or camera, 130
    interrupted.
    """
    from hexctl.cli.console import INTERRUPTED, StopOnInterrupt, print_note, print_result
    from hexctl.errors import RobotFaultError
    from hexctl.vision.latency_trial import CameraLatency

    measuring, place = CameraLatency(**options), options["place"]
    with StopOnInterrupt() as interrupt:
        try:
            done = measuring.run(
                interrupt.requested,
                on_moving=lambda ahead: print_note(_warning(ahead)),
                on_event=lambda text: print_note(f"hexctl: {text}"),
            )
        except RobotFaultError:
            if not interrupt.requested():
                raise
            done = None
    if done is None:
        print_note("hexctl: interrupted; nothing is stored")
        raise typer.Exit(INTERRUPTED)
    print_result(json.dumps(_json(done, place)) if as_json else _text(done, place))


def _warning(ahead: "TwistAhead") -> str:
    return (
        f"{ahead.robot} moves now: it stands up and turns its body to and fro by "
        f"{math.degrees(ahead.amplitude_rad):.0f} degrees, its feet in place, for {ahead.duration_s:.0f} s; "
        "Ctrl-C ends it"
    )


def _json(done: "LatencyTrial", place: Path) -> dict[str, Any]:
    return {
        "latency_ms": round(1000 * done.latency.latency_s, 1),
        "sigma_ms": round(1000 * done.latency.sigma_s, 1),
        "factor": round(done.latency.factor, 3),
        "pictures": done.pictures,
        "seen": done.seen,
        "place": str(place),
    }


def _text(done: "LatencyTrial", place: Path) -> str:
    return (
        f"{place}: pictures come {1000 * done.latency.latency_s:.0f} ± {1000 * done.latency.sigma_s:.0f} ms "
        f"late, by {done.seen} of {done.pictures} pictures; it is stored"
    )
