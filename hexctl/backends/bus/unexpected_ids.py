"""Servos that answer to ids of no joint, while servos of joints do not answer: ids of the wrong file."""

from collections.abc import Collection

import numpy as np

from hexctl.backends.bus.lost_id import FACTORY_ID, adoptable
from hexctl.backends.bus.scan import IDS, answering_ids
from hexctl.backends.bus.serial_line import SerialLine
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.bus_map import BusMap
from hexctl.types import JOINT_NAMES, BoolArray

#: How far beyond the ids of the joints others are looked for: as far as all joints shifted once.
MARGIN = 18


def check_no_unexpected_ids(line: SerialLine, servos: BusMap, found: BoolArray) -> None:
    """Raise RobotFaultError where a servo does not answer and one with an id of no joint does.

    A walk by such a file would move other joints than it means. Only where a servo is missing are ids asked,
    those around the joints' and the factory's. The one servo that may have lost its id is none of them.
    """
    if found.all():
        return
    unexpected = answering_ids(line, servos.driver, servos.protocol, ids_around(servos))
    lost = adoptable(servos, found) is not None and unexpected == [FACTORY_ID]
    if not unexpected or lost:
        return
    missing, others = servos.names(~found), ", ".join(map(str, unexpected))
    if len(unexpected) == 1:
        others = f"id {others} does, which is in no joint"
    else:
        others = f"ids {others} do, which are in no joint"
    verb = "does" if np.count_nonzero(~found) == 1 else "do"
    raise RobotFaultError(
        f"{missing} {verb} not answer, and {others}; compare the ids (hexctl servos scan --robot FILE)"
    )


def ids_around(servos: BusMap) -> list[int]:
    """Ids of no joint that are as near to those of the joints as `MARGIN`, and the factory's."""
    used = set(servos.ids.tolist())
    near = range(min(used) - MARGIN, max(used) + MARGIN + 1)
    return [each for each in IDS if each not in used and (each in near or each == FACTORY_ID)]


def joint_of(servos: BusMap, servo_id: int) -> str | None:
    """Name of the joint to which an id belongs, or None."""
    joints = np.flatnonzero(servos.ids == servo_id).tolist()
    return JOINT_NAMES[joints[0]] if joints else None


def id_differences(servos: BusMap, answering: Collection[int]) -> list[str]:
    """How the ids that answer on a bus differ from those of the joints; empty where they do not."""
    missing = ~np.isin(servos.ids, list(answering))
    strangers = [str(each) for each in answering if joint_of(servos, each) is None]
    notes = [f"no answer: {servos.names(missing)}"] if missing.any() else []
    return notes + ([f"in no joint of the robot file: id {', '.join(strangers)}"] if strangers else [])
