"""Made-up repertoires of `ant`: one leg stuck at its femur or gone, and two neighbours without torque."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hexctl.control.body_symmetry import IDENTITY, BodySymmetry
from hexctl.control.monitor.repertoire import SAFEST, WALK_ON, Candidate, FailedParts, Repertoire, Situation
from hexctl.gait.gait import NAMED_SLOTS
from tests.robots import shipped

#: Left and right change places.
MIRROR = BodySymmetry(legs=(1, 6, 5, 4, 3, 2), mirrored=True, turn_deg=0.0)

#: A sixth of a turn to the left.
TURN = BodySymmetry(legs=(2, 3, 4, 5, 6, 1), mirrored=False, turn_deg=60.0)

SAFE = Candidate(name=SAFEST, slots=(1, 2, 3, 4, 5, 6), body_raise=0.012, tucked_legs=(2,))
ON = Candidate(name=WALK_ON, slots=NAMED_SLOTS["tripod"])
OTHER = Candidate(
    name="code 2", slots=(2, 1, 3, 4, 5, 6), body_raise=0.012, shift=(0.02, 0.03), tucked_legs=(2,)
)


def situation(
    speeds: Sequence[Sequence[float]],
    failed: FailedParts = ((2, "stuck", "femur"),),
    heading_deg: float = 0.0,
    candidates: tuple[Candidate, ...] = (SAFE, ON, OTHER),
) -> Situation:
    """Situation with the speeds of each candidate in a few walks."""
    rows = np.array(speeds, dtype=np.float32).astype(float)
    return Situation(
        failed=failed,
        heading_deg=heading_deg,
        candidates=candidates,
        speeds=rows,
        costs=np.full(rows.shape, 0.5),
    )


#: What leg 2 stuck at its femur is best met with: walking on, beyond the noise.
ON_IS_BEST = situation([[0.70, 0.72, 0.68, 0.70], [0.91, 0.90, 0.92, 0.89], [0.75, 0.70, 0.72, 0.71]])

#: Without leg 2 another code is faster.
OTHER_IS_BEST = situation(
    [[0.70, 0.72, 0.68, 0.70], [0.31, 0.30, 0.32, 0.29], [0.85, 0.84, 0.82, 0.81]],
    failed=((2, "missing", None),),
)


def made_up(*situations: Situation, symmetries: tuple[BodySymmetry, ...] = (IDENTITY,)) -> Repertoire:
    """Repertoire of `ant`."""
    robot = shipped()
    return Repertoire(
        robot=robot.name,
        robot_fingerprint=robot.fingerprint,
        pace_hz=robot.gait.pace_hz,
        amplitude=robot.gait.amplitude,
        height=robot.gait.height,
        direction_step_deg=30.0,
        symmetries=symmetries,
        situations=situations or (ON_IS_BEST, OTHER_IS_BEST),
        origin={"by": "hand"},
    )


def with_fall(one: Situation, candidate: int) -> Situation:
    """A situation in which one walk of a candidate fell."""
    speeds = one.speeds.copy()
    speeds[candidate, 1] = np.nan
    return replace(one, speeds=speeds)
