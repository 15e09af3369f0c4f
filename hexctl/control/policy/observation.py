"""The observation of a policy: its terms, computed from states, the command and the last action."""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass

import numpy as np

from hexctl.control.policy.contract import COMMANDED, Kind, PolicyContract, Term
from hexctl.robot.rotations import components
from hexctl.types import N_JOINTS, FloatArray, RobotState

#: Delay of joint velocities that are differences of angles: half a control period.
DIFFERENCE_DELAY_S = 0.01

#: How long a measurement may be missing before a policy is stopped; meanwhile the last one counts.
MISSING_TICKS = 10


class Observer:
    """Computes observations, (n,), tick by tick; not normalised.

    Joint velocities are those that the servos report. Otherwise they are differences of angles between two
    ticks, half a control period late. A measurement that is missing for a moment keeps its last value.

    Attributes:
        missing: name of a term that has been missing for `MISSING_TICKS`, or None.
    """

    def __init__(self, contract: PolicyContract, period_s: float) -> None:
        self._contract, self._period_s = contract, period_s
        self._histories: list[FloatArray | None] = [None] * len(contract.terms)
        self._values: list[FloatArray | None] = [None] * len(contract.terms)
        self._missing = [0] * len(contract.terms)
        self._measured_rad: FloatArray | None = None
        self._sent_rad: FloatArray | None = None
        self._velocities_rad_s: FloatArray = np.zeros(N_JOINTS)
        self._last_step = self._begin_step = 0
        self.missing: str | None = None

    def begin(self, step: int) -> None:
        """Forget histories: a policy begins, at a step."""
        self._histories, self._sent_rad, self._begin_step = [None] * len(self._histories), None, step

    def sees(self, step: int, state: RobotState) -> None:
        """Take the angles of a step, from which velocities are derived; called at every step."""
        angles_rad = state.joint_positions_rad
        if self._measured_rad is not None and step > self._last_step:
            change_rad = angles_rad - self._measured_rad
            velocities = change_rad / ((step - self._last_step) * self._period_s)
            self._velocities_rad_s = np.where(np.isfinite(velocities), velocities, self._velocities_rad_s)
        known = np.isfinite(angles_rad)
        before = angles_rad if self._measured_rad is None else self._measured_rad
        self._measured_rad = np.where(known, angles_rad, before)
        self._last_step = step

    def observation(
        self,
        step: int,
        state: RobotState,
        *,
        command: FloatArray,
        last_action: FloatArray,
        sent_rad: FloatArray,
    ) -> FloatArray:
        """Observation of a step, (n,), after `sees`.

        Args:
            command: velocity forward and left in m/s and turn in rad/s, (3,).
            last_action: raw, (18,).
            sent_rad: last targets, (18,), hexctl's joint angles.
        """
        before_rad = sent_rad if self._sent_rad is None else self._sent_rad
        self._sent_rad = sent_rad
        seen = _Seen(
            state,
            command,
            last_action,
            time_s=(step - self._begin_step) * self._period_s,
            angles_rad=self._angles_rad,
            velocities_rad_s=self._velocities_rad_s,
            sent_rad=sent_rad,
            sent_rad_s=(sent_rad - before_rad) / self._period_s,
        )
        for index, term in enumerate(self._contract.terms):
            values = self._value(index, term, seen)
            before = self._histories[index]
            rows = np.tile(values, (term.history, 1)) if before is None else np.vstack([before[1:], values])
            self._histories[index] = rows
        histories = [rows for rows in self._histories if rows is not None]
        if self._contract.history_by_time:
            return np.concatenate(histories, axis=1).ravel()
        return np.concatenate([rows.ravel() for rows in histories])

    @property
    def _angles_rad(self) -> FloatArray:
        """Newest known joint angles, (18,)."""
        assert self._measured_rad is not None  # noqa: S101  after `sees`
        return self._measured_rad

    def _value(self, index: int, term: Term, seen: "_Seen") -> FloatArray:
        values = seen.of(term)
        if values is None or not np.isfinite(values).all():
            self._missing[index] += 1
            if self._missing[index] >= MISSING_TICKS:
                self.missing = term.name
            values = self._values[index]
            values = np.zeros(term.width) if values is None else values
        else:
            self._missing[index] = 0
        self._values[index] = values
        return scaled(term, values)


def scaled(term: Term, values: FloatArray) -> FloatArray:
    """Values of a term, (n,), clipped and scaled in its order."""
    if term.scale_first:
        values = values * term.scale
    if term.clip is not None:
        values = np.minimum(np.maximum(values, term.clip[0]), term.clip[1])
    return values if term.scale_first else values * term.scale


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What terms are computed from; arrays of joints are hexctl's, (18,)."""

    state: RobotState
    velocity_command: FloatArray
    last_action: FloatArray
    _: KW_ONLY
    time_s: float
    angles_rad: FloatArray
    velocities_rad_s: FloatArray
    sent_rad: FloatArray
    sent_rad_s: FloatArray

    def of(self, term: Term) -> FloatArray | None:
        if isinstance(term.stand_in, np.ndarray):
            return term.stand_in
        return READERS[term.kind](self, term)

    def lin_vel(self, term: Term) -> FloatArray | None:
        return np.append(self.velocity_command[:2], 0.0) if term.stand_in == COMMANDED else None

    def ang_vel(self, _term: Term) -> FloatArray | None:
        return self.state.angular_velocity_body_rad_s

    def gravity(self, _term: Term) -> FloatArray | None:
        """Unit vector down, in the body frame."""
        if (quaternion := self.state.base_quaternion_world) is None:
            return None
        w, x, y, z = components(quaternion)
        return np.array([-2 * (x * z - w * y), -2 * (y * z + w * x), -(1 - 2 * (x * x + y * y))])

    def relative(self, term: Term) -> FloatArray | None:
        return self.absolute(term) - term.offsets_rad

    def absolute(self, term: Term) -> FloatArray:
        angles_rad = self.sent_rad if term.stand_in == COMMANDED else self.angles_rad
        own: FloatArray = angles_rad[list(term.joints)] - term.zeros_rad
        return own * term.directions

    def velocities(self, term: Term) -> FloatArray:
        measured, known = self.state.joint_velocities_rad_s, self.velocities_rad_s
        if term.stand_in == COMMANDED:
            known = self.sent_rad_s
        elif measured is not None:
            known = np.where(np.isfinite(measured), measured, known)
        return np.asarray(known[list(term.joints)] * term.directions)

    def actions(self, _term: Term) -> FloatArray:
        return self.last_action

    def command(self, _term: Term) -> FloatArray:
        return self.velocity_command

    def phase(self, term: Term) -> FloatArray:
        assert term.period_s is not None  # noqa: S101  checked in the contract
        angle = 2 * np.pi * self.time_s / term.period_s
        return np.array([np.sin(angle), np.cos(angle)])

    def contacts(self, _term: Term) -> FloatArray | None:
        contacts = self.state.foot_contacts
        return None if contacts is None else contacts.astype(float)


#: Readers of terms by kind.
READERS: dict[Kind, Callable[[_Seen, Term], FloatArray | None]] = {
    "base_lin_vel": _Seen.lin_vel,
    "base_ang_vel": _Seen.ang_vel,
    "projected_gravity": _Seen.gravity,
    "joint_pos_rel": _Seen.relative,
    "joint_pos_abs": _Seen.absolute,
    "joint_vel": _Seen.velocities,
    "last_action": _Seen.actions,
    "command": _Seen.command,
    "gait_phase": _Seen.phase,
    "foot_contacts": _Seen.contacts,
}
