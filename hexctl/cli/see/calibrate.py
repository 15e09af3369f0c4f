"""`hexctl see calibrate`: the lens of a camera, by pictures of the printed board."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hexctl.cli.options import JsonOption

if TYPE_CHECKING:
    from hexctl.see.vision.calibration import CalibratedLens, LensCalibration
    from hexctl.see.vision.tags import Picture


def calibrate(
    pictures: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[PICTURE]...",
            help="Pictures of the board on the last page of the sheet. (default: those of --camera)",
            show_default=False,
        ),
    ] = None,
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            help="Number of a camera such as 0, address of a stream, or a video file, from which pictures "
            "are taken while the board is moved. (default: none, pictures are given)",
        ),
    ] = None,
    output: Annotated[
        Path,
        typer.Option("--output", "-o", help="New YAML file, as ROS's camera_info; nothing is replaced."),
    ] = Path("lens.yaml"),
    fisheye: Annotated[
        bool, typer.Option("--fisheye", help="For a lens that sees more than about 110 degrees.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Calibrate the lens of a camera by pictures of the printed board.

    Show the board to the camera at all edges of the picture, tilted and near; hold it still for a moment each
    time. Ctrl-C ends it with what there is.
    """
    from hexctl.cli.console import print_note, print_result
    from hexctl.errors import InputError
    from hexctl.see.vision.calibration import LensCalibration, add_video, read_picture
    from hexctl.see.vision.lens import save_lens

    if bool(pictures) == (camera is not None):
        raise InputError("calibrate: got pictures and a camera, or none; allowed: pictures, or --camera")
    if output.exists():
        raise InputError(f"--output: {output} exists; allowed: a new file, nothing is replaced")
    calibration = LensCalibration(fisheye=fisheye)
    for path in pictures or []:
        refused = calibration.add(read_picture(path))
        if refused is not None:
            print_note(f"{path} is left out: {refused}")
    if camera is not None:
        with _frames(camera) as frames:
            add_video(calibration, frames, on_kept=_print_kept)
    result = calibration.solve()
    try:
        save_lens(result.lens, output)
    except OSError as error:
        raise InputError(f"--output: {output} cannot be written: {error.strerror}") from error
    for sentence in result.missing:
        print_note(f"to make it better: {sentence}")
    print_result(json.dumps(_lens_json(result, output)) if as_json else _lens_text(result, output))


@contextmanager
def _frames(camera: str) -> "Iterator[Iterator[Picture]]":
    """Grey frames of a video, until it ends or Ctrl-C."""
    from hexctl.cli.console import StopOnInterrupt, print_note
    from hexctl.see.video.video_source import open_video

    with open_video(camera, on_event=print_note) as video, StopOnInterrupt(plain=True) as interrupt:

        def frames() -> "Iterator[Picture]":
            while not video.ended and not interrupt.requested():
                frame = video.read()
                if frame is not None:
                    yield frame.gray()

        yield frames()


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
