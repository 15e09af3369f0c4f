"""Names and numbers of the legs and joints: six legs, three joints each, leg-major order."""

N_LEGS = 6
JOINTS_PER_LEG = 3
N_JOINTS = N_LEGS * JOINTS_PER_LEG

#: Joints of one leg, from the body outward.
JOINT_KINDS = ("coxa", "femur", "tibia")

#: All 18 joints in the order of every joint array: leg 1 coxa, femur, tibia, leg 2 ...
JOINT_NAMES = tuple(f"leg{leg}_{kind}" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS)


def leg_slice(leg: int) -> slice:
    """Return where the three joints of leg 1..6 lie in an array of 18."""
    return slice(JOINTS_PER_LEG * (leg - 1), JOINTS_PER_LEG * leg)
