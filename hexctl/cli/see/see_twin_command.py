"""`hexctl see twin`: a rendered camera over a simulated robot."""

import json
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.options.output import JsonOption
from hexctl.cli.options.robot import SeedOption
from hexctl.cli.see.see_options import FPS, LATENCY_MS, PORT, OneRobotOption, size_of
from hexctl.cli.settings import runs_folder
from hexctl.cli.signature import with_options
from hexctl.cli.values import number
from hexctl.options import Range
from hexctl.wire.links import LinkOptions

if TYPE_CHECKING:
    from hexctl.vision.detection.lens import Lens
    from hexctl.vision.twin.twin_camera import TwinReport

NOISE = Range(low=0, high=50)
BLUR_PX = Range(low=0, high=10, unit="px")
SHARE = Range(low=0, high=1)


def point_of(text: str | tuple[float, ...]) -> tuple[float, ...]:
    """Coordinates of a text such as `-1.63,0,1.63`, in m; raises BadParameter for anything else."""
    if isinstance(text, tuple):
        return text
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(abs(one) <= 100 for one in numbers):  # false for nan too
        raise typer.BadParameter(f"got {text}; allowed: X,Y,Z in m, such as -1.63,0,1.63")
    return numbers


@with_options(LinkOptions)
def twin(
    link: dict[str, Any],
    robot: OneRobotOption = None,
    http_port: Annotated[
        int,
        number(
            "--http-port", PORT, "Port of this computer for the pictures, a whole number, {}; 0: any free."
        ),
    ] = 0,
    fps: Annotated[
        float,
        number("--fps", FPS, "Pictures that the camera takes each second, {}; fewer if drawing is slow."),
    ] = 30.0,
    latency_ms: Annotated[
        float,
        number(
            "--latency-ms",
            LATENCY_MS,
            "Milliseconds from what it sees to its picture's arrival, {}.",
        ),
    ] = 80.0,
    lens: Annotated[
        Path | None,
        typer.Option("--lens", help="Calibration of its lens, a file of ROS. (default: that of a webcam)"),
    ] = None,
    size: Annotated[
        Any,
        typer.Option(
            "--size",
            parser=size_of,
            metavar="WIDTHxHEIGHT",
            help="Size of the pictures in px, such as 640x480. (default: that of the lens, 1280x720)",
        ),
    ] = None,
    position: Annotated[
        Any,
        typer.Option("--position", parser=point_of, metavar="X,Y,Z", help="Where it stands, in metres."),
    ] = "-1.63,0,1.63",
    look_at: Annotated[
        Any,
        typer.Option("--look-at", parser=point_of, metavar="X,Y,Z", help="Where it looks, in metres."),
    ] = "0,0,0",
    noise: Annotated[
        float,
        number("--noise", NOISE, "Standard deviation of each pixel of 0..255, a whole number or not, {}."),
    ] = 4.0,
    blur: Annotated[
        float,
        number("--blur", BLUR_PX, "Standard deviation of the blur in px, a whole number or not, {}."),
    ] = 0.7,
    drop: Annotated[float, number("--drop", SHARE, "Fraction of pictures that are lost, {}.")] = 0.0,
    shadow: Annotated[
        float, number("--shadow", SHARE, "Fraction by which a shadow that wanders darkens the floor, {}.")
    ] = 0.0,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            "--fault",
            help="What happens to it, repeatable: moved:0.05,0,0@10 (m, after 10 s), turned:2@10 (degrees to "
            "the left), covered:2@10 (a hand is over the robot's tag for 2 s). (default: nothing)",
        ),
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonOption = False,
) -> None:
    """Be a network camera that looks at the robot of hexctl serve --backend sim, until Ctrl-C.

    Its pictures are drawn by MuJoCo, with tag 10 on the robot (edge 10 cm) and tags 0 to 3 on the floor, and
    have the flaws of a real camera. hexctl see --camera URL takes them like those of any other. Its lens is
    written under runs/, as if it had been calibrated.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result
    from hexctl.vision.twin.twin_camera import TwinCamera, TwinStarted

    camera = TwinCamera(
        **link,
        robot=robot,
        http_port=int(http_port),
        fps=fps,
        latency_ms=latency_ms,
        lens=lens,
        size_px=size,
        position_m=position,
        look_at_m=look_at,
        noise=noise,
        blur_px=blur,
        drop=drop,
        shadow=shadow,
        faults=tuple(fault or ()),
        seed=int(seed),
    )

    def on_started(started: TwinStarted) -> None:
        print_note(
            f"camera over {started.robot} at {started.url} (in a browser {started.page_url}); Ctrl-C ends it"
        )
        lens_file = lens or _written(camera.camera().lens)
        print_note(f"look  hexctl see --camera {started.url} --lens {shlex.quote(str(lens_file))}")

    with StopOnInterrupt(plain=True) as interrupt:
        report = camera.run(
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
    """File with a lens, as a calibration would have written it."""
    from hexctl.vision.detection.lens import save_lens

    file = runs_folder() / "see-twin-lens.yaml"
    file.parent.mkdir(parents=True, exist_ok=True)
    save_lens(lens, file)
    return file


def _age(report: "TwinReport") -> str:
    if report.latency_s is None:
        return "none of which arrived"
    return f"{1000 * report.latency_s:.0f} ms old at their arrival"
