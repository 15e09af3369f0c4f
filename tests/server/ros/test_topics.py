"""What the topics and the diagnostics of a robot say, and where it listens beside a ROS router."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from hexctl.server.ros.topics import TOPICS, RobotMessages, measured_ns, publisher_endpoint, statuses
from hexctl.server.serve_options import ServeOptions
from hexctl.server.service import ENDPOINT_BESIDE_ROUTER, link_beside_router, router_warnings
from hexctl.server.snapshot import RobotSnapshot
from hexctl.types import N_JOINTS, RobotState, ServoReadings
from hexctl.wire import ros_cdr
from hexctl.wire.links import load_link
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.ros_names import RosNode
from hexctl.wire.ros.telemetry import Level
from tests.server.bench import stopped_for
from tests.wire.ros.decoding import decoded

ROBOT = load_robot("ant")
#: Turned by 0.4, 0.1 and -0.05 rad about z, y and x.
QUATERNION = np.array([0.978784085054, -0.014542269399, 0.053927616469, 0.197134597238])


def snapshot(state: RobotState) -> RobotSnapshot:
    return RobotSnapshot(state=state, orientation=QUATERNION, stamp_ns=10**18)


@pytest.fixture
def messages() -> RobotMessages:
    return RobotMessages(ROBOT, urdf_of(ROBOT), "hexctl")


def walking(angles_rad: np.ndarray) -> RobotState:
    position = np.array([1.0, 2.0, 0.1])
    return RobotState(
        angles_rad, 0.0, True, base_position_world=position, base_quaternion_world=QUATERNION, age_s=0.01
    )


def test_feet_in_tf_are_where_the_kinematics_has_them(messages: RobotMessages) -> None:
    from scipy.spatial.transform import Rotation

    angles_rad = np.random.default_rng(2).uniform(ROBOT.joint_lower_rad, ROBOT.joint_upper_rad)
    shown = snapshot(walking(angles_rad))
    moving = decoded(telemetry.TRANSFORMS, messages.moving_frames(shown)).transforms
    fixed = decoded(telemetry.TRANSFORMS, messages.fixed_frames(0)).transforms
    frames = {one.child_frame_id: one for one in (*moving, *fixed)}

    def place(name: str, until: str) -> tuple[np.ndarray, Rotation]:
        if name == until:
            return np.zeros(3), Rotation.identity()
        moved = frames[name].transform.translation
        turned = frames[name].transform.rotation
        at, rotation = place(frames[name].header.frame_id, until)
        own = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w])
        return at + rotation.apply([moved.x, moved.y, moved.z]), rotation * own

    feet = np.array([place(f"leg{leg}_foot", "base_link")[0] for leg in range(1, 7)])
    np.testing.assert_allclose(feet, foot_positions_body(ROBOT, angles_rad), atol=1e-9)
    at, turned = place("base_link", "odom")
    np.testing.assert_allclose(at, [1.0, 2.0, 0.1])
    np.testing.assert_allclose(turned.as_quat()[[3, 0, 1, 2]], QUATERNION)


def test_a_robot_that_does_not_know_where_it_is_has_no_odometry(messages: RobotMessages) -> None:
    shown = snapshot(RobotState(ROBOT.stance_angles_rad, 0.0, False))
    assert messages.odometry(shown) is None
    names = [
        one.child_frame_id for one in decoded(telemetry.TRANSFORMS, messages.moving_frames(shown)).transforms
    ]
    assert len(names) == 18
    assert "base_link" not in names


def test_stamps_are_those_of_the_measurement(messages: RobotMessages) -> None:
    shown = snapshot(walking(ROBOT.stance_angles_rad))
    assert measured_ns(shown) == 10**18 - 10_000_000
    stamp = decoded(ros_cdr.JOINT_STATE, messages.joint_states(shown)).header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == 10**18 - 10_000_000


def test_endpoints_have_numbers_of_their_own_and_no_unknown_orientation_is_sent(
    messages: RobotMessages,
) -> None:
    state = walking(ROBOT.stance_angles_rad)
    assert messages.imu(RobotSnapshot(state=state)) is None
    endpoints = [publisher_endpoint(RosNode(), topic) for topic in TOPICS]
    assert len({one.entity_id for one in endpoints}) == len(TOPICS)


SERVOS = ServoReadings(
    ages_s=np.zeros(N_JOINTS),
    efforts=np.zeros(N_JOINTS),
    currents_a=np.full(N_JOINTS, np.nan),
    voltages_v=np.full(N_JOINTS, 7.4),
    temperatures_c=np.full(N_JOINTS, 35.0),
)
STATE = RobotState(np.zeros(N_JOINTS), 0.0, True, servos=SERVOS, battery_v=11.1, battery_share=0.5)


def told(state: RobotState, stopped: str | None = None) -> RobotSnapshot:
    return RobotSnapshot(state=state, stop=stopped_for(stopped), posture="commanded", controller="me")


def test_all_is_well() -> None:
    robot, *servos = statuses(told(STATE), "hexctl")
    assert robot.level is Level.OK
    assert (robot.values["battery (V)"], robot.values["charge (%)"]) == ("11.1", "50")
    assert len(servos) == N_JOINTS
    assert servos[3].name == "hexctl: leg2_coxa"
    assert servos[3].values == {"temperature (C)": "35", "voltage (V)": "7.4", "effort (%)": "0"}
    assert len(statuses(told(replace(STATE, servos=None)), "hexctl")) == 1


@pytest.mark.parametrize(
    ("change", "stopped", "level", "word"),
    [
        ({"warnings": ("leg 2: low voltage",)}, None, Level.WARN, "low voltage"),
        ({"age_s": np.inf}, None, Level.STALE, "nothing new"),
        ({}, "fell", Level.ERROR, "stopped: fell (its body leant too far)"),
        ({"healthy": False, "fault": "no power"}, None, Level.ERROR, "no power"),
    ],
)
def test_levels_of_a_robot(change: dict[str, object], stopped: str | None, level: Level, word: str) -> None:
    robot = statuses(told(replace(STATE, **change), stopped), "hexctl")[0]  # type: ignore[arg-type]
    assert (robot.level, word in robot.message) == (level, True)


@pytest.mark.parametrize(
    ("temperature_c", "age_s", "error", "level"),
    [
        (35.0, 0.0, "stale", Level.STALE),
        (62.0, 0.0, "", Level.WARN),
        (69.0, 0.0, "", Level.ERROR),
        (35.0, np.inf, "", Level.STALE),
        (35.0, 0.0, "overload", Level.ERROR),
        (np.nan, 0.0, "", Level.OK),
    ],
)
def test_levels_of_a_servo(temperature_c: float, age_s: float, error: str, level: Level) -> None:
    temperatures, ages = SERVOS.temperatures_c.copy(), SERVOS.ages_s.copy()
    temperatures[4], ages[4] = temperature_c, age_s
    stale = np.arange(N_JOINTS) == 4 if error == "stale" else None
    errors = tuple(error if joint == 4 and stale is None else "" for joint in range(N_JOINTS))
    servos = replace(SERVOS, temperatures_c=temperatures, ages_s=ages, errors=errors)
    levels = [
        status.level
        for status in statuses(told(replace(STATE, servos=servos, stale_joints=stale)), "hexctl")[1:]
    ]
    assert levels == [level if joint == 4 else Level.OK for joint in range(N_JOINTS)]


ROUTER = "tcp/localhost:7447"


def test_the_default_port_is_left_to_the_router() -> None:
    assert link_beside_router(load_link(), ROUTER).endpoint == ENDPOINT_BESIDE_ROUTER
    for endpoint in ("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", "tls/localhost:7447"):
        with pytest.raises(InputError, match="7448"):
            link_beside_router(load_link(connect=endpoint), ROUTER)
    other = load_link(connect="tcp/127.0.0.1:7500")
    assert link_beside_router(other, ROUTER) == other
    assert link_beside_router(load_link(), "tcp/10.0.0.2:7447") == load_link()


def test_options_are_checked_when_they_are_given_and_warn_who_may_drive() -> None:
    with pytest.raises(InputError, match="ros_domain"):
        ServeOptions(ros=ROUTER, ros_domain=999)
    with pytest.raises(InputError, match="ros"):
        ServeOptions(ros="7447")
    beside, may = router_warnings(link_beside_router(load_link(), ROUTER), ROUTER, drive=False)
    assert "7448" in beside
    assert "may stop" in may
    (may,) = router_warnings(load_link(connect="tcp/127.0.0.1:7500"), ROUTER, drive=True)
    assert "may drive" in may
