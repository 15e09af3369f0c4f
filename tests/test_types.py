"""The order of the joints, which every array and every wire format relies on."""

from hexctl.types import JOINT_NAMES, leg_slice


def test_joints_lie_leg_by_leg_from_the_body_outward() -> None:
    assert JOINT_NAMES[:4] == ("leg1_coxa", "leg1_femur", "leg1_tibia", "leg2_coxa")
    assert JOINT_NAMES[-1] == "leg6_tibia"
    assert len(set(JOINT_NAMES)) == 18


def test_a_leg_is_found_in_an_array_of_joints() -> None:
    for leg in range(1, 7):
        assert JOINT_NAMES[leg_slice(leg)] == tuple(f"leg{leg}_{kind}" for kind in ("coxa", "femur", "tibia"))
