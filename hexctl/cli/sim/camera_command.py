"""`hexctl sim camera`: a rendered camera over a simulated robot."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hexctl.cli.output_options import JsonOption
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options
from hexctl.vision.twin.twin_camera import TwinCamera, TwinStarted

if TYPE_CHECKING:
    from hexctl.vision.detection.lens import Lens
    from hexctl.vision.twin.shooting import TwinReport


@with_options(TwinCamera)
def camera(options: dict[str, Any], as_json: JsonOption = False) -> None:
    """Simulate a network camera that looks at the robot of hexctl serve --backend sim, until Ctrl-C.

    Its pictures are drawn by MuJoCo, with tag 10 on the robot (edge 10 cm) and tags 0 to 3 on the floor, and
    have the flaws of a real camera. hexctl see --camera URL takes them like those of any other. Its lens is
    written under runs/, as if it had been calibrated.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result

    service = TwinCamera(**options)

    def on_started(started: TwinStarted) -> None:
        print_note(
            f"camera over {started.robot} at {started.url} (in a browser {started.page_url}); Ctrl-C ends it"
        )
        lens_file = options["lens"] or _written(service.camera().lens)
        print_note(f"look  hexctl see --camera {started.url} --lens {shlex.quote(str(lens_file))}")

    with StopOnInterrupt(plain=True) as interrupt:
        report = service.run(
            interrupt.requested, on_started=on_started, on_event=lambda text: print_note(f"hexctl: {text}")
        )
    if as_json:
        print_result(json.dumps(report.to_dict()))
    else:
        print_result(
            f"{report.fps:.1f} pictures a second, {_age(report)}; "
            f"{report.skipped} not drawn, {report.late} late"
        )


def _written(lens: "Lens") -> Path:
    from hexctl.vision.detection.lens import save_lens

    file = runs_folder() / "sim-camera-lens.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    save_lens(lens, file)
    return file


def _age(report: "TwinReport") -> str:
    if report.latency_s is None:
        return "none of which arrived"
    return f"{1000 * report.latency_s:.0f} ms old at their arrival"
