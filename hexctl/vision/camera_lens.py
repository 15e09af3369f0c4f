"""The lens of a camera, calibrated by pictures of the printed board: its options, and the file it becomes."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from hexctl.errors import InputError, argument, check_type
from hexctl.vision.camera_options import never
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.lens_calibration import CalibratedLens, LensCalibration, add_video, read_picture
from hexctl.vision.detection.tags import Picture
from hexctl.vision.video.video_source import VideoSource, open_video


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraLens:
    """A calibration of a camera's lens by the printed board: options, checked when they are given.

        CameraLens(camera="0", output="lens.yaml").run(stop_requested)

    Attributes:
        pictures: files of pictures of the board; none with a camera.
        camera: number of a camera, its device, an address of a stream, or a video file, from which pictures
            are taken while the board is moved; None with pictures.
        output: new file of the lens, a camera calibration of ROS (`camera_info`).
        fisheye: whether the lens sees more than about 110 degrees.
        size_px: width and height that a camera is asked for; None leaves it as it is.
        fps: pictures per second that a camera is asked for; None leaves it as it is.
    """

    pictures: Sequence[str | Path] = ()
    camera: str | int | Path | None = None
    output: str | Path = Path("lens.yaml")
    fisheye: bool = False
    size_px: tuple[int, int] | None = None
    fps: float | None = None

    def __post_init__(self) -> None:
        check_type(self.output, (str, Path), "output")
        if bool(self.pictures) == (self.camera is not None):
            raise InputError(
                f"calibrate: got pictures and {argument('camera')}, or neither; "
                f"allowed: pictures, or {argument('camera')}"
            )
        for name, asked in (("size", self.size_px), ("fps", self.fps)):
            if self.pictures and asked is not None:
                raise InputError(
                    f"{argument(name)}: got one with pictures; allowed: with {argument('camera')}"
                )
        output = Path(self.output)
        if output.exists():
            raise InputError(
                f"{argument('output')}: {output} exists; allowed: a new file, nothing is replaced"
            )
        if not output.parent.is_dir():
            raise InputError(f"{argument('output')}: got {output}; allowed: a folder that is there")

    def run(
        self,
        stop_requested: Callable[[], bool] = never,
        *,
        on_kept: Callable[[LensCalibration], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> CalibratedLens:
        """Calibrate the lens and write its file.

        Args:
            stop_requested: asked between frames of a camera; the lens is that of the pictures until then.
            on_kept: called with each picture of a camera that counts.
            on_event: called with a line for each picture file that is left out, and when the camera is lost
                or found.

        Raises InputError for pictures and files that are not allowed, too few pictures, and a lens that does
        not fit; RobotFaultError for a camera that is not there.
        """
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
            with open_video(str(self.camera), size_px=self.size_px, fps=self.fps, on_event=on_event) as video:
                add_video(calibration, _grey_frames(video, stop_requested), on_kept=on_kept)
        calibrated = calibration.solve()
        try:
            save_lens(calibrated.lens, Path(self.output))
        except OSError as error:
            raise InputError(
                f"{argument('output')}: {self.output} cannot be written: {error.strerror}"
            ) from error
        return calibrated


def _grey_frames(video: VideoSource, stop_requested: Callable[[], bool]) -> Iterator[Picture]:
    """Grey frames of a video, until it ends or a stop is requested."""
    while not video.ended and not stop_requested():
        frame = video.read()
        if frame is not None:
            yield frame.gray()
