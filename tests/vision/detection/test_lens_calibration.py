from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.lens_calibration import LensCalibration, add_video
from hexctl.vision.detection.tags import Picture
from tests.vision.boards import BoardPictures

LENSES = {
    "webcam": Lens(
        width_px=960, height_px=540, matrix=np.array([[720.0, 0, 489], [0, 716, 262], [0, 0, 1]]),
        distortion=np.array([-0.28, 0.09, 5e-4, -3e-4, -0.01]),
    ),
    "480p": Lens(
        width_px=640, height_px=480, matrix=np.array([[560.0, 0, 325], [0, 558, 236], [0, 0, 1]]),
        distortion=np.array([0.08, -0.15, 1e-3, -5e-4, 0.02]),
    ),
    "fisheye": Lens(
        width_px=960, height_px=540, matrix=np.array([[390.0, 0, 480], [0, 390, 270], [0, 0, 1]]),
        model="equidistant", distortion=np.array([-0.02, 0.004, -0.001, 0.0002]),
    ),
}  # fmt: skip


@cache
def pictures(name: str, count: int = 20) -> tuple[Picture, ...]:
    return tuple(BoardPictures(LENSES[name]).around(count))


def ray_error_px(lens: Lens, found: Lens) -> float:
    """RMS over the picture of how far another lens sees the same rays, once it is turned to them."""
    columns, rows = np.meshgrid(np.linspace(0, lens.width_px - 1, 21), np.linspace(0, lens.height_px - 1, 15))
    points_px = np.column_stack([columns.ravel(), rows.ravel()])
    rays, others = (
        each / np.linalg.norm(each, axis=1, keepdims=True)
        for each in (lens.rays(points_px), found.rays(points_px))
    )
    turn = Rotation.align_vectors(others, rays)[0]
    apart_px = found.pixels(turn.apply(rays)) - points_px
    return float(np.sqrt(np.square(apart_px).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize("name", LENSES)
def test_a_lens_is_recovered_within_half_a_pixel(name: str) -> None:
    calibration = LensCalibration(fisheye=name == "fisheye")
    for picture in pictures(name):
        calibration.add(picture)
    result = calibration.solve()
    assert ray_error_px(LENSES[name], result.lens) < 0.5
    assert result.lens.matrix[0, 0] == pytest.approx(LENSES[name].matrix[0, 0], rel=0.004)
    assert result.lens.calibrated
    assert result.rms_px < 0.3
    assert result.doubt_px < 0.6
    assert result.missing == ()
    assert result.coverage > 0.7


def test_pictures_that_do_not_differ_do_not_count() -> None:
    calibration = LensCalibration()
    assert calibration.add(pictures("480p")[0]) is None
    assert calibration.add(pictures("480p")[0]) == "too alike"
    assert calibration.add(np.full((480, 640), 128, dtype=np.uint8)) == "no board"
    with pytest.raises(InputError, match=r"got 1 pictures .*1 too alike, 1 no board.*8 or more"):
        calibration.solve()


@pytest.mark.slow
def test_it_says_where_the_board_was_not_seen() -> None:
    calibration = LensCalibration()
    for picture in BoardPictures(LENSES["480p"]).around(12, reach=0.2, tilt_deg=3):
        calibration.add(picture)
    said = " ".join(calibration.missing())
    for side in ("left", "right", "upper", "lower"):
        assert f"nearer to the {side} edge" in said
    assert "tilt it" in said
    assert "more pictures" in said


def test_a_fisheye_is_not_taken_for_a_usual_lens() -> None:
    calibration = LensCalibration()
    for picture in pictures("fisheye"):
        calibration.add(picture)
    with pytest.raises(InputError, match=r"differ by \d+ px.*a fisheye"):
        calibration.solve()


def test_a_picture_that_fits_to_no_flat_board_is_left_out() -> None:
    board = BoardPictures(LENSES["webcam"], seed=5)
    torn = board.draw(np.eye(3), np.array([0.02, 0.01, 0.4]))
    torn[270:] = np.roll(torn[270:], 6, axis=1)  # as of a camera that reads while the board moves
    calibration = LensCalibration()
    assert calibration.add(torn) is None
    for picture in pictures("webcam")[:12]:
        calibration.add(picture)
    result = calibration.solve()
    assert result.pictures == calibration.pictures - 1
    assert ray_error_px(LENSES["webcam"], result.lens) < 0.5


def test_pictures_of_two_sizes_are_refused() -> None:
    calibration = LensCalibration()
    calibration.add(pictures("480p")[0])
    with pytest.raises(InputError, match="960x540 px after one of 640x480"):
        calibration.add(pictures("webcam")[0])


@pytest.mark.slow
def test_of_a_video_frames_are_kept_in_which_the_board_is_still() -> None:
    moving = pictures("480p")
    calibration = LensCalibration()
    add_video(calibration, iter(moving))
    assert calibration.pictures == 0
    told: list[int] = []
    still = [picture for picture in moving for _ in range(2)]
    add_video(calibration, iter(still), on_kept=lambda now: told.append(now.pictures))
    assert told == list(range(1, calibration.pictures + 1))
    assert all(second == first + 1 for first, second in pairwise(told))
    assert not calibration.missing()
