"""A servo that has fallen back to the id 1: named at connect, and given its id again."""

import time

import pytest

from hexctl.backends.bus.tools import adopt
from hexctl.errors import RobotFaultError
from hexctl.robot.schema import ServosSection
from hexctl.robot.servos.bus_map import BusMap, bus_map_of
from hexctl.robot.servos.servo_models import DEFAULT_BAUDS
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import a_map, bus_board, servos_on
from tests.robots import shipped

pytestmark = pytest.mark.realtime

FAMILIES = (("dynamixel", "ax12a"), ("dynamixel", "xl430-w250"), ("feetech", "sts3215"), ("lx16a", "lx16a"))
LOST = "leg 3 tibia \\(id 29\\)"


def _without_one(driver: str, model: str) -> BusMap:
    """Servos with ids from 21: id 1 belongs to none."""
    joints = {name: {"id": 21 + place} for place, name in enumerate(JOINT_NAMES)}
    kinds = {"femur": {"offset_deg": -10, "sign": -1}, "tibia": {"offset_deg": 40}}
    return bus_map_of(ServosSection.model_validate({"model": model, **kinds, **joints}), driver)


@pytest.mark.parametrize(("driver", "model"), FAMILIES)
def test_it_is_named_at_connect_and_adopted(driver: str, model: str) -> None:
    bus_map, robot = _without_one(driver, model), shipped("phantomx")
    with bus_board(bus_map, "lost-id:3:tibia") as board:
        servos = servos_on(board, bus_map)
        with servos:
            note = servos.read().warnings[0]
        assert note.startswith("leg 3 tibia (id 29) does not answer, and a servo with id 1 does: ")
        assert "hexctl servos adopt --robot FILE" in note
        assert board._servos[8].servo_id == 1, "nothing is written at connect"
        adoption = adopt(robot, bus_map, board.path, DEFAULT_BAUDS[driver])
        assert (adoption.joint, adoption.servo.servo_id) == (8, 29)
        assert adoption.angle_deg is not None
        assert adoption.angle_deg * 3.14159 / 180 == pytest.approx(robot.stance_angles_rad[8], abs=0.01)
        servo = board._servos[8]
        assert servo.servo_id == 29
        assert not servo.holds
        if isinstance(servo, BusServo):
            servo.restart()
            assert servo.servo_id == 29, "kept without power"
        with servos_on(board, bus_map) as again:
            assert not [each for each in again.read().warnings if "lost its id" in each]


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ((), "joints without a servo: none; exactly one must be missing"),
        (("mute:3:tibia",), f"{LOST} does not answer, and no servo with id 1 does"),
        (("lost-id:3:tibia", "mute:2:coxa"), rf"leg 2 coxa \(id 24\), {LOST}; exactly one"),
    ],
)
def test_nothing_is_written_unless_exactly_one_is_lost(faults: tuple[str, ...], message: str) -> None:
    bus_map = _without_one("feetech", "sts3215")
    with bus_board(bus_map, *faults) as board:
        before = [servo.servo_id for servo in board._servos]
        with pytest.raises(RobotFaultError, match=message):
            adopt(shipped("phantomx"), bus_map, board.path, 1_000_000)
        assert [servo.servo_id for servo in board._servos] == before


def test_a_servo_of_another_model_or_place_is_left_alone() -> None:
    bus_map = _without_one("feetech", "sts3215")
    for address, value, message in ((3, 5, "reports model number"), (57, 0, f"where {LOST} cannot")):
        with bus_board(bus_map, "lost-id:3:tibia") as board:
            servo = board._servos[8]
            assert isinstance(servo, BusServo)
            if address == 3:
                servo.memory[address] = value
            else:
                board._robot._positions_rad[8] -= 3.2  # type: ignore[attr-defined]
                time.sleep(0.2)
            with pytest.raises(RobotFaultError, match=message):
                adopt(shipped("phantomx"), bus_map, board.path, 1_000_000)
            assert servo.servo_id == 1


def test_a_robot_file_with_id_1_has_none_to_lose() -> None:
    with pytest.raises(RobotFaultError, match=r"id 1 belongs to a joint of the robot file \(leg 1 coxa"):
        adopt(shipped("phantomx"), a_map(), "/dev/nothing", 1_000_000)
