"""Gaits at the pace that the servos of a robot hold: what it walks when it is asked to walk fast.

A body covers about A f at a step amplitude A and a pace f, whatever the swing share is. The servos limit f
by the path of the joints (`JointPath`), and the path depends on A and on the swing share: in a longer swing
the foot returns more slowly. So the fastest gait is the one with the largest

    A f_most(A, s) / OVERDRIVE

of a few amplitudes A, with the swing share s of the gait, and on five legs also with that of `two_up`.
The steering may lengthen strokes by `OVERDRIVE`, and the joints follow these, too.
"""

from dataclasses import replace
from functools import lru_cache

from hexctl.control.assessment.crawl import two_up
from hexctl.control.assessment.joint_path import JointPath
from hexctl.control.assessment.static_stability import DIRECTION_STEP_RAD
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.gait.gait import PACE_HZ, Gait, Motion
from hexctl.robot.model import Robot

#: Tried amplitudes, as multiples of the gait's.
STROKES = (0.8, 1.0, 1.2)


def fast_gaits(
    robot: Robot, gait: Gait, *, heading_rad: float, lost: tuple[int, ...] = (), reorder: bool = False
) -> tuple[Gait, ...]:
    """Variants of a gait at the pace that the servos hold without some legs, the fastest first.

    Args:
        heading_rad: direction of travel in the body frame.
        lost: legs that do not carry.
        reorder: whether the order of five legs may change.

    Empty if the servos cannot carry the robot, or a foot is out of reach.
    """
    direction = round(heading_rad / DIRECTION_STEP_RAD)
    return _fast_gaits(robot, gait, direction, tuple(sorted(lost)), reorder)


@lru_cache(maxsize=256)
def _fast_gaits(
    robot: Robot, gait: Gait, direction: int, lost: tuple[int, ...], reorder: bool
) -> tuple[Gait, ...]:
    motion = Motion(heading_rad=DIRECTION_STEP_RAD * direction)
    found = []
    for stroke in STROKES:
        longer = replace(gait, amplitude=min(1.0, stroke * gait.amplitude))
        tucked = _without(longer, lost)
        shapes = [longer]
        if reorder and len(tucked.posture.tucked_legs) == 1:
            spread = two_up(robot, tucked, heading_rad=motion.heading_rad)
            shapes.append(replace(spread, posture=gait.posture))
        for shape in shapes:
            path = JointPath.of(robot, _without(shape, lost), motion)
            pace_hz = 0.0 if path is None else min(path.most_pace_hz / OVERDRIVE, PACE_HZ.high)
            found += [replace(shape, pace_hz=round(pace_hz, 3))] if pace_hz > 0 else []
    return tuple(sorted(found, key=lambda one: -one.amplitude * one.pace_hz))


def _without(gait: Gait, lost: tuple[int, ...]) -> Gait:
    tucked = tuple({*gait.posture.tucked_legs, *lost})
    return replace(gait, posture=replace(gait.posture, tucked_legs=tucked))
