"""A walk without a central gait: each leg steps by its own load and its neighbours' load.

After D. Owaki, M. Goda, S. Miyazawa and A. Ishiguro, "A Minimal Model Describing Hexapedal Interlimb
Coordination: The Tegotae-Based Approach", Frontiers in Neurorobotics 11:29 (2017). The phase phi of a leg is
about pi / 2 in the air and about 3 pi / 2 on the floor. Its own load N keeps it on the floor, and the mean
load of its neighbours lets it lift off:

    dphi_i / dt = omega - sigma_1 N_i cos(phi_i) + sigma_2 cos(phi_i) mean_{j in L(i)} N_j

With only the first load it is the rule of quadrupeds (D. Owaki and A. Ishiguro, "A Quadruped Robot
Exhibiting Spontaneous Gait Transitions from Walking to Trotting to Galloping", Scientific Reports 7:277,
2017). Here L(i) are the two legs next to leg i, around the body; sigma is in multiples of omega, N of a third
of the robot's weight. The middle of the stance is at u = 0 of the foot trajectory: cos(phi) = sin(2 pi u).
"""

from dataclasses import replace

import numpy as np

from hexctl.control.preparation import WalkStart
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.ik.legs import link_points_body
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, JOINTS_PER_LEG, N_LEGS, FloatArray, RobotState

#: sigma_1 and sigma_2, as multiples of omega: the fastest of 0.05 to 1 for `ant` with a failed leg. With
#: 0.3 robots with weak servos lose speed, with 1 all do.
OWN_LOAD, NEIGHBOURS_LOAD = 0.1, 0.1

#: Limits of the rate of a phase, as multiples of omega.
LEAST_RATE, MOST_RATE = 0.0, 2.0

#: Time constant over which loads are averaged, as a share of a cycle.
LOAD_CYCLES = 0.05

#: Legs that share the weight if the load counts as 1.
CARRYING = 3


class DecentralisedWalk(SteeredWalk):
    """Walks along the line of the trial; its phases start from those of the gait and follow the loads.

    It has no belief about its legs. The velocity is that of the law that holds the line.
    """

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start, hold=possible_hold(start.plans[0], start.frame))
        self.leave_plain()
        self._loads = LegLoads(start.robot)
        self._mean_load: FloatArray = np.zeros((*start.batch_shape, N_LEGS))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        cycles = (step - self._last_step) * self._period_s * self._pattern.pace_hz[..., np.newaxis]
        load = self._loads.of(state)
        if load is not None:
            share = 1 - np.exp(-cycles / LOAD_CYCLES)
            self._mean_load = self._mean_load + share * (load - self._mean_load)
        rate = phase_rate(self.leg_phases, self._mean_load)
        # The pace advances all phases equally; only the rest of the rate is each leg's own.
        self._pattern = replace(self._pattern, phases=self._pattern.phases + cycles * (rate - 1))
        return super().targets_rad(step, state)


def phase_rate(u: FloatArray, load: FloatArray) -> FloatArray:
    """Rates of the phases as multiples of omega, leading shape + (6,).

    Args:
        u: normalised times of the legs, leading shape + (6,).
        load: on each, 1 for a third of the robot's weight, leading shape + (6,).
    """
    neighbours = (np.roll(load, 1, axis=-1) + np.roll(load, -1, axis=-1)) / 2
    drive = NEIGHBOURS_LOAD * neighbours - OWN_LOAD * load
    return np.clip(1 + np.sin(2 * np.pi * u) * drive, LEAST_RATE, MOST_RATE)


class LegLoads:
    """Loads of the legs from measured torques or contacts."""

    def __init__(self, robot: Robot) -> None:
        points = link_points_body(robot, robot.stance_angles_rad)
        from_femur = robot.stance_feet_body - points[..., 1, :]
        whole_n = GRAVITY_M_S2 * robot.mass_kg / CARRYING
        self._per_nm = 1 / (np.hypot(from_femur[:, 0], from_femur[:, 1]) * whole_n)

    def of(self, state: RobotState) -> FloatArray | None:
        """Loads, 1 for a third of the weight, leading shape + (6,); None if nothing measures them.

        From the torques of the femurs if known, else from the contacts of the feet.
        """
        if state.joint_torques_nm is not None:
            carried_nm = np.maximum(0.0, -state.joint_torques_nm[..., 1::JOINTS_PER_LEG])
            return np.asarray(np.nan_to_num(carried_nm) * self._per_nm)
        return None if state.foot_contacts is None else state.foot_contacts.astype(float)
