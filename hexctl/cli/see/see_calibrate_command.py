"""`hexctl see calibrate`: the lens of a camera, by pictures of the printed board."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.output_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.vision.camera_lens import CameraLens

if TYPE_CHECKING:
    from hexctl.vision.detection.lens_calibration import CalibratedLens, LensCalibration


@with_options(CameraLens)
def calibrate(
    options: dict[str, Any],
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="PICTURE",
            help="Pictures of the board on the last page of the sheet. (default: those of --camera)",
            show_default=False,
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the lens of a camera by pictures of the printed board.

    Show the board to the camera at all edges of the picture, tilted and near; hold it still for a moment each
    time. Ctrl-C ends it and uses the pictures so far.
    """
    from hexctl.cli.console import StopOnInterrupt, print_note, print_result

    calibration = CameraLens(**options, pictures=pictures or ())
    with StopOnInterrupt(plain=True) as interrupt:
        result = calibration.run(
            interrupt.requested, on_kept=_print_kept, on_event=lambda text: print_note(f"hexctl: {text}")
        )
    for sentence in result.missing:
        print_note(f"to make it better: {sentence}")
    output = options["output"]
    print_result(json.dumps(_lens_json(result, output)) if as_json else _lens_text(result, output))


def _print_kept(calibration: "LensCalibration") -> None:
    from hexctl.cli.console import print_note

    print_note(f"{calibration.pictures} pictures; {'; '.join(calibration.missing()) or 'that is enough'}")


def _lens_json(result: "CalibratedLens", output: Path) -> dict[str, object]:
    return {
        "lens": str(output),
        "pictures": result.pictures,
        "rms_px": round(result.rms_px, 3),
        "doubt_px": round(result.doubt_px, 3),
        "coverage": round(result.coverage, 2),
        "missing": list(result.missing),
    }


def _lens_text(result: "CalibratedLens", output: Path) -> str:
    return (
        f"{output}: {result.pictures} pictures, which cover {result.coverage:.0%} of the picture; it misses "
        f"the board by {result.rms_px:.2f} px, rays by about {result.doubt_px:.1f} px"
    )
