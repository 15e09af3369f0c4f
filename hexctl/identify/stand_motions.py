"""Motions of a robot on a stand that show what its servos are."""

import numpy as np

from hexctl.control.controllers import Controller
from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, FloatArray, RobotState

#: Amplitude of a joint about the stance, as a share of the distance to its nearer limit, and at most.
SHARE, MOST_RAD = 0.6, 0.45

#: Share of the speed limit that motions use.
SPEED_SHARE = 0.9

#: Slow waves show stiffness and friction, fast ones inertia, steps the dead time and the maximum torque.
WAVES_HZ = (0.25, 0.5, 1.0, 2.0, 3.0)
WAVE_S, STEP_S, PAUSE_S = 4.0, 1.0, 1.0

#: Steps to either side, as shares of the amplitude.
STEPS = (0.3, -0.3, 0.6, -0.6, 1.0, -1.0, 0.0)


class StandMotions(Controller):
    """Waves of all joints about the stance with growing frequency, then steps of one joint kind at a time.

    Args:
        robot: on a stand, with room below its feet.
        period_s: of the control.
    """

    def __init__(self, robot: Robot, period_s: float) -> None:
        to_limit = np.minimum(
            robot.joint_upper_rad - robot.stance_angles_rad, robot.stance_angles_rad - robot.joint_lower_rad
        )
        self._stance_rad = robot.stance_angles_rad
        self._amplitude_rad = np.clip(SHARE * to_limit, 0.0, MOST_RAD)
        self._fastest_rad_s = SPEED_SHARE * robot.joint_max_speed_rad_s
        self._period_s = period_s
        self._shapes = _shapes()
        self._starts_s = np.cumsum([0.0, *[lasts_s for lasts_s, _, _ in self._shapes]])
        self._last_rad = robot.stance_angles_rad.copy()
        self._last_step = 0

    @property
    def duration_s(self) -> float:
        """Duration of all motions."""
        return float(self._starts_s[-1])

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Targets, (18,), no faster than the joints may turn."""
        wanted = self._stance_rad + self._amplitude_rad * self._share(step * self._period_s)
        most = self._fastest_rad_s * self._period_s * max(1, step - self._last_step)
        self._last_rad = self._last_rad + np.clip(wanted - self._last_rad, -most, most)
        self._last_step = step
        return self._last_rad

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the last motion is over."""
        return step * self._period_s >= self.duration_s

    def _share(self, time_s: float) -> FloatArray:
        """Displacement of each joint, (18,), as a share of its amplitude."""
        index = int(np.searchsorted(self._starts_s, time_s, side="right")) - 1
        if index >= len(self._shapes):
            return np.zeros(N_JOINTS)
        _, frequency_hz, moved = self._shapes[index]
        passed_s = time_s - self._starts_s[index]
        if frequency_hz > 0:
            # Slower joints would not follow a fast wave: it is as large as their speed allows.
            largest = self._fastest_rad_s / (2 * np.pi * frequency_hz) / np.maximum(self._amplitude_rad, 1e-9)
            fade = min(1.0, passed_s, WAVE_S - passed_s)
            wave = fade * np.sin(2 * np.pi * frequency_hz * passed_s)
            return np.asarray(moved * np.minimum(1.0, largest) * wave)
        return np.asarray(moved * STEPS[min(int(passed_s / STEP_S), len(STEPS) - 1)])


def _shapes() -> list[tuple[float, float, FloatArray]]:
    """Duration, frequency (0 for steps), and which joints move to which side, (18,)."""
    kinds = np.arange(N_JOINTS) % JOINTS_PER_LEG
    legs = np.repeat(np.arange(N_LEGS), JOINTS_PER_LEG)
    sides = np.where(legs % 2 == 0, 1.0, -1.0)
    groups = [np.where(kinds == kind, sides, 0.0) for kind in range(JOINTS_PER_LEG)]
    shapes = [(PAUSE_S, 0.0, np.zeros(N_JOINTS))]
    shapes += [(WAVE_S, frequency_hz, sides) for frequency_hz in WAVES_HZ]
    shapes += [(len(STEPS) * STEP_S, 0.0, group) for group in groups]
    return shapes
