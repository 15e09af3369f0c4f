"""Legs: kinematics both ways, and the odometry of feet that stay."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import hexctl
from hexctl.errors import InputError, LimitError, ReachError, WrongTypeError
from hexctl.ik.leg_odometer import GAP_S, JUDGED_S, WINDOW_S, LegOdometer, LostLegWatch
from hexctl.ik.leg_odometry import LegMotions, leg_motions, stance_motions, standing
from hexctl.ik.legs import (
    check_joint_limits,
    foot_positions_body,
    link_points_body,
    solve_legs,
    solve_legs_within_limits,
)
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, N_JOINTS, N_LEGS, BoolArray, FloatArray
from tests.driven import Command, Driven, course, driven
from tests.robots import ROBOT_NAMES, shipped

names = st.sampled_from(ROBOT_NAMES)
eighteen = st.lists(st.floats(0, 1), min_size=N_JOINTS, max_size=N_JOINTS).map(np.array)


def _angles_within_limits(robot: Robot, shares: FloatArray) -> FloatArray:
    span = robot.joint_upper_rad - robot.joint_lower_rad
    angles: FloatArray = robot.joint_lower_rad + shares * span
    return angles


def _feet_around(robot: Robot, shares: FloatArray) -> FloatArray:
    """Feet all around the mounts, some of them out of reach."""
    reach = float(np.hypot(*robot.link_vectors_m.T).sum())
    return robot.mount_positions_body + (2 * shares.reshape(N_LEGS, 3) - 1) * reach


def _foot_before_the_coxa(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each foot is on the side of the coxa axis to which its leg points."""
    points = link_points_body(robot, angles)
    yaw = robot.mount_yaws_rad + angles[::3]
    outward = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.asarray(((points[:, 3] - points[:, 0])[:, :2] * outward).sum(axis=-1) > 1e-3)


def _knee_up(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each knee is above the line from the femur joint to the foot."""
    slopes = np.arctan2(robot.link_vectors_m[:, 1], robot.link_vectors_m[:, 0])
    return np.asarray(np.sin(angles[2::3] + slopes[2] - slopes[1]) < -1e-3)


@given(name=names, shares=eighteen)
def test_feet_that_can_be_reached_come_back_from_their_angles(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = _feet_around(robot, shares)
    solution = solve_legs(robot, feet)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    reachable = solution.reachable
    np.testing.assert_allclose(back[reachable], feet[reachable], atol=1e-7)
    off = np.linalg.norm(back - feet, axis=-1)
    assert (off[~reachable] > 0).all(), "a foot that can be put in place is reachable"


@given(name=names, shares=eighteen)
def test_angles_come_back_from_their_feet(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    solution = solve_legs(robot, feet)
    before = _foot_before_the_coxa(robot, angles)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    np.testing.assert_allclose(back[before], feet[before], atol=1e-6)
    same = np.repeat(before & _knee_up(robot, angles), 3)
    np.testing.assert_allclose(solution.joint_positions_rad[same], angles[same], atol=1e-6)


@given(name=names, shares=eighteen)
def test_a_foot_out_of_reach_is_flagged_and_the_leg_points_at_it(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = robot.mount_positions_body + 5 * (_feet_around(robot, shares) - robot.mount_positions_body)
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    femur, tibia = np.hypot(*robot.link_vectors_m[1:].T)
    points = link_points_body(robot, solution.joint_positions_rad)
    to_foot, to_wanted = points[:, 3] - points[:, 1], feet - points[:, 1]
    distance = np.linalg.norm(to_wanted, axis=-1)
    beyond = distance > femur + tibia + 1e-9
    assert not solution.reachable[beyond].any()
    np.testing.assert_allclose(np.linalg.norm(to_foot[beyond], axis=-1), femur + tibia, atol=1e-9)
    cosine = (to_foot * to_wanted).sum(axis=-1) / np.linalg.norm(to_foot, axis=-1) / distance
    np.testing.assert_allclose(cosine[beyond], 1, atol=1e-9)


@pytest.mark.parametrize("where", ["coxa axis", "femur joint", "mount"])
def test_a_foot_too_near_is_flagged_and_finite(where: str) -> None:
    robot = shipped()
    points = link_points_body(robot, robot.stance_angles_rad)
    feet = {
        "coxa axis": points[:, 0] + [0, 0, -0.001],
        "femur joint": points[:, 1],
        "mount": robot.mount_positions_body,
    }[where]
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    assert where != "femur joint" or not solution.reachable.any()


def test_many_poses_at_once_equal_each_alone_to_the_last_bit() -> None:
    robot = shipped("phantomx")
    shares = np.random.default_rng(3).uniform(size=(4, 5, N_JOINTS))
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    together = solve_legs(robot, feet)
    for index in np.ndindex(4, 5):
        alone = solve_legs(robot, feet[index])
        assert np.array_equal(together.joint_positions_rad[index], alone.joint_positions_rad)
        assert np.array_equal(together.reachable[index], alone.reachable)
        assert np.array_equal(feet[index], foot_positions_body(robot, angles[index]))


@pytest.mark.parametrize("leg", [1, 3, 6])
def test_a_foot_out_of_reach_names_its_leg_and_how_far_it_may_be(leg: int) -> None:
    robot = shipped()
    feet = np.tile(robot.stance_feet_body, (5, 1, 1))
    feet[3, leg - 1] *= 1.5
    feet[4, leg - 1] *= 2.0
    hip = np.array([0.080 + 0.0503, -0.0112])
    worst_m = np.hypot(*(np.array([0.408, -0.242]) - hip))
    with pytest.raises(ReachError, match=f"leg {leg}: foot {worst_m:.4f} m.*0.0441 to 0.1889 m"):
        solve_legs_within_limits(robot, feet)


@pytest.mark.parametrize(
    ("leg", "kind", "side"), [(1, "coxa", -1), (4, "femur", 1), (6, "tibia", -1), (2, "tibia", 1)]
)
def test_a_joint_out_of_range_is_named_with_its_angle_and_range(leg: int, kind: str, side: int) -> None:
    robot = shipped("pexod")
    joint = 3 * (leg - 1) + JOINT_KINDS.index(kind)
    limits = robot.joint_lower_rad if side < 0 else robot.joint_upper_rad
    angles = np.tile(robot.stance_angles_rad, (4, 1))
    angles[1, joint], angles[2, joint] = limits[joint] + side * np.radians((1, 3))
    degrees, most = np.degrees(angles[2, joint]), 90 if kind == "coxa" else 45
    with pytest.raises(LimitError, match=f"leg {leg} {kind}: needs {degrees:.1f} .*-{most} to {most} deg"):
        check_joint_limits(robot, angles)


# As programs call them.

#: The functions without their types, for what a type checker would refuse as well.
api: Any = hexctl


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        *(("feet_body", wrong) for wrong in ("far", [[0.1, 0.2], [0.3]], np.zeros(3), 0.1)),
        *(("feet_body", wrong) for wrong in (np.zeros((5, 3)), np.full((6, 3), np.nan))),
        *(("joint_positions_rad", wrong) for wrong in (None, np.zeros(17), np.zeros((18, 2)), 0.4)),
        ("joint_positions_rad", [0.0] * 17 + [np.inf]),
    ],
)
def test_wrong_arguments_are_refused_by_name(name: str, wrong: Any) -> None:
    call = api.joint_angles_of_feet if name == "feet_body" else api.feet_of_joint_angles
    with pytest.raises(hexctl.InputError, match=f"^{name}"):
        call(shipped(), wrong)
    with pytest.raises(WrongTypeError, match=r"^robot"):
        call("ant", wrong)


# Odometry.

#: Feet that do not roll.
POINT_FEET = replace(shipped(), foot_radius_m=1e-9)

STANCE = shipped().stance_angles_rad

AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (8, 1, 0, 0))


def joints_of(*feet_body: FloatArray) -> FloatArray:
    return solve_legs(POINT_FEET, np.stack(feet_body)).joint_positions_rad


def moved(*feet_body: FloatArray, **known: Any) -> LegMotions:
    """Motion from the feet before and after 0.1 s."""
    return leg_motions(POINT_FEET, np.array([0.0, 0.1]), joints_of(*feet_body), **known)


@given(
    forward_m=st.floats(-0.02, 0.02),
    left_m=st.floats(-0.02, 0.02),
    yaw_rad=st.floats(-0.1, 0.1),
    up_m=st.floats(-0.01, 0.01),
)
def test_feet_that_stay_tell_the_motion(forward_m: float, left_m: float, yaw_rad: float, up_m: float) -> None:
    before = POINT_FEET.stance_feet_body
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    turned_back = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]])
    after = (before - [forward_m, left_m, up_m]) @ turned_back
    found = moved(before, after)
    assert found.motions[0] == pytest.approx([forward_m, left_m, yaw_rad], abs=1e-6)
    assert np.diff(found.height_m)[0] == pytest.approx(up_m, abs=1e-6)
    joints = joints_of(before, after)
    contacts = np.ones((2, 6), dtype=bool)
    contacts[1, 3] = False
    joints[1, 9:12] += 0.1  # a foot that has lifted
    shift = stance_motions(POINT_FEET, joints, contacts, np.array([0.0, yaw_rad]), 0.1)
    assert [shift[0].real, shift[0].imag] == pytest.approx([forward_m, left_m], abs=1e-6)


def test_a_body_that_leans_knows_up_and_its_height() -> None:
    lean = np.radians(5.0)
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    stands = standing(POINT_FEET, joints_of(POINT_FEET.stance_feet_body @ turn)[0])
    assert stands.up_body == pytest.approx(np.array([0, 0, 1.0]) @ turn)
    assert stands.height_m == pytest.approx(POINT_FEET.standing_height_m, abs=1e-6)
    assert stands.above_m == pytest.approx(np.zeros(6), abs=1e-6)


def test_feet_in_the_air_do_not_count() -> None:
    before = POINT_FEET.stance_feet_body.copy()
    before[[0, 2, 4], 2] += 0.03
    after = before - [0.01, 0.0, 0.0]
    after[[0, 2, 4], 0] += 0.03
    assert moved(before, after).motions[0] == pytest.approx([0.01, 0, 0], abs=1e-5)


@pytest.mark.parametrize("slipping", [0, 4])
def test_one_foot_that_slips_is_outvoted(slipping: int) -> None:
    before, after = POINT_FEET.stance_feet_body, POINT_FEET.stance_feet_body - [0.002, 0.0, 0.0]
    after[slipping, 1] += 0.02
    forward_m, left_m, yaw_rad = moved(before, after).motions[0]
    assert (forward_m, left_m) == pytest.approx([0.002, 0], abs=6e-4)
    assert abs(yaw_rad) < 0.003


def test_a_leg_that_is_gone_carries_nothing() -> None:
    before = POINT_FEET.stance_feet_body.copy()
    before[1, 2] -= 0.02
    after = before - [0.002, 0.0, 0.0]
    after[1] += [0.02, 0.0, 0.0]
    for contacts in (None, np.ones((2, 6), dtype=bool)):
        found = moved(before, after, foot_contacts=contacts, lost_legs=(2,))
        assert found.motions[0] == pytest.approx([0.002, 0, 0], abs=1e-5)
        assert found.height_m == pytest.approx([POINT_FEET.standing_height_m] * 2, abs=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "gait", "world", "failure", "most"),
    [
        ("ant", "tripod", "flat", Failure(leg=2, kind="locked"), 0.12),
        ("ant", "tripod", "flat", Failure(leg=2, kind="missing"), 0.12),
        pytest.param("ant", "tripod", "flat", None, 0.06, marks=pytest.mark.long),
        pytest.param("phantomx", "tripod", "flat", None, 0.06, marks=pytest.mark.long),
        pytest.param("pexod", "wave", "flat", None, 0.12, marks=pytest.mark.long),
        pytest.param("pexod", "tripod", "real:3", None, 0.25, marks=pytest.mark.long),
    ],
)
def test_leg_odometry_of_walks(
    robot: str, gait: str, world: str, failure: Failure | None, most: float
) -> None:
    walk = driven(robot, AHEAD, gait=gait, world=world, failure=failure)
    true = course(walk.motions)[-1]
    distance_m = np.hypot(*true[:2])
    found = leg_motions(shipped(robot), walk.times_s, walk.joints_rad)
    off = course(found.motions)[-1] - true
    assert np.hypot(*off[:2]) < most * distance_m
    if failure is None:
        assert abs(np.degrees(off[2])) < 120 * most * distance_m
        assert np.sqrt(np.mean(np.square(found.height_m - walk.height_m))) < 0.0025
    if world == "real:3":
        known = leg_motions(shipped(robot), walk.times_s, walk.joints_rad, walk.contacts)
        assert np.hypot(*(course(known.motions)[-1] - true)[:2]) < 0.08 * distance_m


def test_a_robot_that_stands_does_not_move_and_has_no_lost_leg() -> None:
    walk = driven("ant", ((5, 0, 0, 0),))
    assert np.abs(course(leg_motions(shipped(), walk.times_s, walk.joints_rad).motions)).max() < 1e-3
    assert set(watched("ant", walk)) == {()}


def test_what_cannot_be_is_refused() -> None:
    stance = np.tile(shipped().stance_angles_rad, (3, 1))
    for times_s in ([0.0], [0.0, 1.0, 1.0], [0.0, 1.0]):
        with pytest.raises(InputError, match="allowed"):
            leg_motions(shipped(), np.array(times_s), stance)


# State by state.


@pytest.mark.slow
def test_state_by_state_is_as_all_at_once() -> None:
    walk = driven("ant", AHEAD)
    odometer = LegOdometer(shipped())
    each = [odometer.update(at_s, angles) for at_s, angles in zip(walk.times_s, walk.joints_rad, strict=True)]
    assert each[0] is None
    together = leg_motions(shipped(), walk.times_s, walk.joints_rad)
    motions = [one.motion for one in each if one is not None and one.motion is not None]
    assert np.array(motions) == pytest.approx(together.motions, abs=1e-9)
    heights_m = [(one.height_m - one.rise_m, one.height_m) for one in each if one is not None]
    assert np.array(heights_m)[:, 1] == pytest.approx(together.height_m[1:], abs=1e-9)
    assert np.array(heights_m)[:, 0] == pytest.approx(together.height_m[:-1], abs=1e-9)


def test_a_state_that_is_no_later_or_not_finite_is_left_out() -> None:
    odometer = LegOdometer(shipped())
    assert odometer.update(1.0, STANCE) is None
    for at_s, angles in ((1.0, STANCE), (0.9, STANCE), (1.01, np.full(18, np.nan))):
        assert odometer.update(at_s, angles) is None
    step = odometer.update(1.02, STANCE)
    assert step is not None
    assert (step.from_s, step.to_s) == (1.0, 1.02)


def test_after_a_gap_the_height_is_known_and_the_motion_is_not() -> None:
    odometer = LegOdometer(shipped())
    odometer.update(1.0, STANCE)
    step = odometer.update(1.0 + GAP_S, STANCE)
    assert step is not None
    assert step.motion is None
    assert step.height_m == pytest.approx(shipped().standing_height_m, abs=0.002)
    step = odometer.update(1.02 + GAP_S, STANCE)
    assert step is not None
    assert step.motion == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.slow
def test_legs_that_are_told_and_one_that_is_noticed_are_left_out() -> None:
    walk = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    odometer = LegOdometer(shipped("pexod"))
    odometer.known_lost_legs = (5,)
    assert odometer.lost_legs == (5,)
    odometer.known_lost_legs = ()
    for at_s, angles, pose in zip(walk.times_s, walk.joints_rad, walk.poses, strict=True):
        odometer.update(at_s, angles)
        odometer.see(at_s, pose)
    assert odometer.lost_legs == (2,)


# A lost leg.

TURNING: tuple[Command, ...] = ((1, 0, 0, 0), (8, 0, 0, 0.7))

#: Standard deviation of sightings in m, m and rad.
NOISE = np.array([0.005, 0.005, 0.005])


def watched(
    robot: str, walk: Driven, *, wild: float = 0.0, seen_from_s: float = 0.0
) -> list[tuple[int, ...]]:
    """Legs believed lost after each state; every other state there is a sighting, some of them anywhere."""
    watch, rng = LostLegWatch(shipped(robot)), np.random.default_rng(1)
    believed = []
    for tick, (at_s, angles) in enumerate(zip(walk.times_s, walk.joints_rad, strict=True)):
        watch.listen(at_s, angles)
        off = rng.uniform(-1, 1, 3) if rng.random() < wild else rng.normal(size=3) * NOISE
        if tick % 2 == 0 and at_s >= seen_from_s:
            watch.see(at_s, walk.poses[tick] + off)
        believed.append(watch.lost_legs)
    return believed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "leg", "wild"), [("phantomx", 2, 0.0), ("pexod", 2, 0.0), ("pexod", 2, 0.1)]
)
def test_a_missing_leg_that_nobody_told_of_is_noticed(robot: str, leg: int, wild: float) -> None:
    walk = driven(robot, AHEAD, failure=Failure(leg=leg, kind="missing"), told=False)
    believed = watched(robot, walk, wild=wild)
    assert believed[-1] == (leg,)
    assert walk.times_s[believed.index((leg,))] < 7.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "world", "commands"),
    [
        ("ant", "flat", TURNING),
        pytest.param("phantomx", "flat", AHEAD, marks=pytest.mark.long),
        pytest.param("pexod", "flat", AHEAD, marks=pytest.mark.long),
        ("pexod", "real:3", TURNING),
        ("ant", "real:3", AHEAD),
    ],
)
def test_a_whole_robot_has_no_lost_leg(robot: str, world: str, commands: tuple[Command, ...]) -> None:
    walk = driven(robot, commands, world=world)
    assert set(watched(robot, walk)) == {()}


@pytest.mark.slow
def test_a_leg_that_carries_again_is_believed_again() -> None:
    """The poses of a whole robot after those of one that lost a leg."""
    broken = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    whole = driven("pexod", AHEAD)
    watch = LostLegWatch(shipped("pexod"))
    for walk, from_s in ((broken, 0.0), (whole, 20.0)):
        if from_s:
            watch.restart()
            assert watch.lost_legs == (2,)
        for at_s, angles, pose in zip(walk.times_s, walk.joints_rad, walk.poses, strict=True):
            watch.listen(from_s + at_s, angles)
            watch.see(from_s + at_s, pose)
    assert watch.lost_legs == ()


@pytest.mark.slow
def test_nothing_is_judged_by_a_short_sight() -> None:
    walk = driven("pexod", AHEAD, failure=Failure(leg=2, kind="missing"), told=False)
    seen_from_s = walk.times_s[-1] - 0.5 * WINDOW_S - JUDGED_S / 2
    assert watched("pexod", walk, seen_from_s=seen_from_s)[-1] == ()


def placed(mount: dict[str, Any]) -> tuple[list[float], float]:
    """Position of a mount and its yaw in degrees, from either of its two forms."""
    if "azimuth_deg" in mount:
        azimuth = math.radians(mount["azimuth_deg"])
        x, y = mount["radius_m"] * math.cos(azimuth), mount["radius_m"] * math.sin(azimuth)
        return [x, y, 0.0], mount["azimuth_deg"]
    return mount["position_m"], mount["yaw_deg"]


def leg_mjcf(number: int, mount: dict[str, Any], links: dict[str, Any]) -> str:
    """One leg: a vertical hinge, and two hinges whose positive angle lifts the link, in the leg's plane."""
    (x, y, z), yaw_deg = placed(mount)
    coxa, femur, tibia = (links[kind]["end_m"] for kind in ("coxa", "femur", "tibia"))
    weight = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    return f"""
    <body name="coxa{number}" pos="{x!r} {y!r} {z!r}" euler="0 0 {yaw_deg!r}">{weight}
      <joint type="hinge" axis="0 0 1"/>
      <body name="femur{number}" pos="{coxa[0]!r} 0 {coxa[1]!r}">{weight}
        <joint type="hinge" axis="0 -1 0"/>
        <body name="tibia{number}" pos="{femur[0]!r} 0 {femur[1]!r}">{weight}
          <joint type="hinge" axis="0 -1 0"/>
          <site name="foot{number}" pos="{tibia[0]!r} 0 {tibia[1]!r}"/>
        </body>
      </body>
    </body>"""


class Chain:
    """A robot's legs on a fixed trunk in MuJoCo."""

    def __init__(self, name: str) -> None:
        import mujoco

        file = Path(__file__).parents[2] / "configs" / "robots" / f"{name}.yaml"
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        legs = [
            leg_mjcf(number, mount, content["links"]) for number, mount in enumerate(content["mounts"], 1)
        ]
        text = f"<mujoco><compiler angle='degree'/><worldbody>{''.join(legs)}</worldbody></mujoco>"
        self._model = mujoco.MjModel.from_xml_string(text)
        self._data = mujoco.MjData(self._model)

    def points(self, joints_rad: FloatArray) -> FloatArray:
        """Coxa axis, femur joint, knee and foot of each leg, (6, 4, 3)."""
        import mujoco

        self._data.qpos[:] = joints_rad
        mujoco.mj_forward(self._model, self._data)
        return np.array(
            [
                [
                    *(self._data.body(f"{link}{leg}").xpos.copy() for link in ("coxa", "femur", "tibia")),
                    self._data.site(f"foot{leg}").xpos.copy(),
                ]
                for leg in range(1, 7)
            ]
        )


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_forward_kinematics_are_those_of_a_chain_built_by_hand(name: str) -> None:
    robot, chain = shipped(name), Chain(name)
    random = np.random.default_rng(1)
    for _ in range(30):
        joints_rad = random.uniform(robot.joint_lower_rad, robot.joint_upper_rad)
        np.testing.assert_allclose(link_points_body(robot, joints_rad), chain.points(joints_rad), atol=1e-12)
    np.testing.assert_allclose(
        foot_positions_body(robot, robot.stance_angles_rad),
        chain.points(robot.stance_angles_rad)[:, -1],
        atol=1e-12,
    )
