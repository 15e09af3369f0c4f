"""What standing still tells of the world, before the first trial.

Servos under load stay behind what they are told. By how much each of them does, in the stance, says how stiff
they are, what the robot weighs, where the weight hangs and which legs carry it; and so which of the simulated
worlds this one is like. The sag of all joints is taken as jointly normal with the landscapes over the worlds
of a prior, and the landscapes are conditioned on it, in the coordinates of the worlds.
"""

import math

import numpy as np

from hexctl.types import FloatArray

#: Variance of the noise of what is seen, relative to that between the worlds along each principal direction.
NOISE = 0.1

#: To this what servos say is believed: a Dynamixel AX-12A reads its angle in steps of 0.29 degrees. Without
#: it, joints that hardly differ between worlds would be listened to as if they were read without error.
RESOLUTION_RAD = math.radians(0.3)

#: Directions in which the worlds differ by less than this share of a joint's variance say nothing.
NEGLIGIBLE = 0.02

#: The noise is doubled so often at most; what is stranger still tells nothing anyway.
DOUBLINGS = 60


def narrowed(sags_rad: FloatArray, seen_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a sag that was seen tells of the coordinates of the worlds, standard normal before.

    A landscape is mean + root.T @ x, with a row of the root for each world. When the sag is farther off than
    any world explains, its noise is raised until it is not: a robot with play in its joints stands like no
    simulated one, and is not explained away.

    Args:
        sags_rad: of the worlds, NaN where the robot fell, (worlds, joints).
        seen_rad: of this robot, NaN for joints that do not say, (joints,).

    Returns:
        Mean of x, (worlds,), and what its root is to be multiplied with, (worlds, worlds).
    """
    worlds, stood = len(sags_rad), np.isfinite(sags_rad).all(axis=1)
    if stood.sum() < 2:
        return np.zeros(worlds), np.eye(worlds)
    known = np.isfinite(seen_rad)
    spread = np.hypot(sags_rad[stood].std(axis=0), RESOLUTION_RAD)
    mean = sags_rad[stood][:, known].mean(axis=0)
    apart = np.zeros((worlds, int(known.sum())))  # worlds in which the robot fell are told nothing of
    apart[stood] = (sags_rad[stood][:, known] - mean) / spread[known] / np.sqrt(stood.sum() - 1)
    left, sizes, right = np.linalg.svd(apart, full_matrices=False)
    told = sizes**2 > NEGLIGIBLE
    if not told.any():
        return np.zeros(worlds), np.eye(worlds)
    left, sizes = left[:, told], sizes[told]
    surprise = right[told] @ ((seen_rad[known] - mean) / spread[known])
    noise = _noise(sizes**2, surprise)
    weights = sizes / (sizes**2 + noise)
    shrunk = 1 - np.sqrt(noise / (sizes**2 + noise))
    return left @ (weights * surprise), np.eye(worlds) - (left * shrunk) @ left.T


def _noise(variances: FloatArray, surprise: FloatArray) -> float:
    """Return the least noise, not below NOISE, with which a surprise is no greater than expected."""
    noise = NOISE
    for _ in range(DOUBLINGS):
        if float((surprise**2 / (variances + noise)).mean()) <= 1:
            break
        noise *= 2
    return noise
