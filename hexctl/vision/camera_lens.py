"""The lens of a camera, calibrated by pictures of the printed board: its options, and the file it becomes.

Light to import, without OpenCV, until it runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from hexctl.errors import InputError, argument
from hexctl.options import RARE, UNTYPED, Typed, check_fields
from hexctl.vision.camera_options import VideoOptions, check_new_file
from hexctl.waiting import StopRequested, never_stop

if TYPE_CHECKING:
    from hexctl.vision.detection.lens_calibration import CalibratedLens, LensCalibration
    from hexctl.vision.video.videos import VideoSource


@dataclass(frozen=True, kw_only=True)
class CameraLens(VideoOptions):
    """A calibration of a camera's lens by the printed board: options, checked when they are given.

    CameraLens(camera="0", output="lens.yaml").run(stop_requested)
    """

    pictures: Annotated[Sequence[str | Path], UNTYPED] = ()
    """Files of pictures of the board; none with a camera."""

    camera: Annotated[str | int | Path | None, Typed(parse=str)] = None
    """Camera that films the board while it is moved: its number such as 0, its device, an address, or a video
    file. (default: none, pictures are given)
    """

    output: Annotated[str | Path, Typed(short="o")] = Path("lens.yaml")
    """New YAML file, as ROS's camera_info; nothing is replaced."""

    fisheye: Annotated[bool, RARE] = False
    """Calibrate a lens that sees more than about 110 degrees."""

    def __post_init__(self) -> None:
        check_fields(self)
        camera = argument("camera")
        if bool(self.pictures) == (self.camera is not None):
            raise InputError(
                f"calibrate: got pictures and {camera}, or neither; allowed: pictures, or {camera}"
            )
        for name in ("size_px", "fps"):
            if self.pictures and getattr(self, name) is not None:
                raise InputError(f"{argument(name)}: got one with pictures; allowed: with {camera}")
        check_new_file("output", self.output)

    def run(
        self,
        stop_requested: StopRequested = never_stop,
        *,
        on_view: "Callable[[LensCalibration], None]" = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> "CalibratedLens":
        """Calibrate the lens and write its file.

        Args:
            stop_requested: called between frames; if True, the pictures so far are used.
            on_view: called with each kept picture of a camera.
            on_event: called with a line for each rejected picture file, and when the camera is lost or
                found.

        Raises InputError for invalid pictures or files, too few pictures, and a lens without a fit;
        RobotFaultError for a missing camera.
        """
        from hexctl.vision.detection.lens import save_lens
        from hexctl.vision.detection.lens_calibration import LensCalibration, read_picture

        calibration = LensCalibration(fisheye=self.fisheye)
        for path in self.pictures:
            gray = read_picture(Path(path))
            try:
                refused = calibration.add(gray)
            except InputError as error:
                raise InputError(f"{path}: {error}") from error
            if refused is not None:
                on_event(f"{path} is left out: {refused}")
        if self.camera is not None:
            with self.open_video(on_event) as video:
                _add_video(calibration, video, stop_requested, on_view)
        calibrated = calibration.solve()
        try:
            save_lens(calibrated.lens, Path(self.output))
        except OSError as error:
            raise InputError(
                f"{argument('output')}: {self.output} cannot be written: {error.strerror}"
            ) from error
        return calibrated


def _add_video(
    calibration: "LensCalibration",
    video: "VideoSource",
    stop_requested: StopRequested,
    on_view: "Callable[[LensCalibration], None]",
) -> None:
    """Keep frames in which the board is held still, until they end or nothing is missing any more."""
    while not video.ended and not stop_requested():
        frame = video.read()
        if frame is not None and calibration.add_steady(frame.gray()):
            on_view(calibration)
            if not calibration.missing():
                return
