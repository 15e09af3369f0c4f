import numpy as np
import pytest

from hexctl.vision.detection.planar_pose import fitted_pose
from hexctl.vision.detection.robot_tracker import CORNER_PX, CornerNoise
from hexctl.vision.detection.tags import UNIT_CORNERS

SQUARE_PX = 30 * UNIT_CORNERS


def learned(sigma_px: float, pictures: int, noise: CornerNoise | None = None, seed: int = 0) -> CornerNoise:
    """What is known after pictures of a square whose corners have noise."""
    noise, random = CornerNoise() if noise is None else noise, np.random.default_rng(seed)
    for _ in range(pictures):
        seen_px = SQUARE_PX + random.normal(0.0, sigma_px, (4, 2))
        fit = fitted_pose(SQUARE_PX, seen_px)
        noise.learn(fit.pose.of_points(fit.scale * SQUARE_PX) - seen_px)
    return noise


@pytest.mark.parametrize("sigma_px", [0.5, 1.0, 2.0])
def test_the_noise_is_learned_from_what_is_no_square(sigma_px: float) -> None:
    found_px = [learned(sigma_px, 20, seed=seed).sigma_px for seed in range(40)]
    assert np.mean(found_px) == pytest.approx(sigma_px, rel=0.1)
    assert np.std(found_px) < 0.15 * sigma_px


@pytest.mark.parametrize("sigma_px", [0.0, 0.1])
def test_corners_are_never_believed_to_be_better_than_at_first(sigma_px: float) -> None:
    assert CornerNoise().sigma_px == CORNER_PX
    assert learned(sigma_px, 200).sigma_px == CORNER_PX


def test_noise_that_is_over_is_forgotten() -> None:
    noise = learned(2.0, 50)
    assert learned(0.0, 100, noise).sigma_px == CORNER_PX
