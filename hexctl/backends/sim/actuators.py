"""From joint targets to actuator commands."""

import math
from typing import Self

import numpy as np

from hexctl.backends.sim.simulation_model import Simulation
from hexctl.types import BoolArray, FloatArray, leg_slice


def behind_play(shaft_rad: FloatArray, servo_rad: FloatArray, half_play_rad: FloatArray) -> FloatArray:
    """New angle of a shaft behind a servo with play.

    Backlash is a hysteresis: the shaft waits until the servo has crossed the play, then follows half the play
    behind.
    """
    return np.clip(shaft_rad, servo_rad - half_play_rad, servo_rad + half_play_rad)


class ActuatorModel:
    """Applies loss, calibration error, backlash and jammed joints to targets of one or n robots.

    The delay comes after them, in MuJoCo's actuators (`simulation_model.delay_steps`).

    Attributes:
        plain: whether targets reach the actuators unchanged.
        asked_rad: last targets of the servos, leading shape + (18,), except jammed ones.
    """

    def __init__(
        self,
        simulation: Simulation,
        heard_rad: FloatArray,
        shaft_rad: FloatArray,
        jammed_at_rad: FloatArray,
    ) -> None:
        """Set the last targets and shaft angles.

        `jammed_at_rad`, leading shape + (18,), is the angle of jammed joints; NaN for joints that obey.
        """
        self._simulation = simulation
        self._heard_rad = heard_rad
        self._half_play_rad = simulation.play_rad / 2
        self._loose = bool(self._half_play_rad.any())
        self._shaft_rad = shaft_rad
        self.asked_rad: FloatArray = shaft_rad.copy()
        self._jam(jammed_at_rad)

    def _jam(self, jammed_at_rad: FloatArray) -> None:
        simulation = self._simulation
        self._jammed_at_rad = jammed_at_rad
        self._obeys: BoolArray = np.isnan(jammed_at_rad)
        self.plain = not (
            not self._obeys.all()
            or simulation.joint_offsets_rad.any()
            or self._loose
            or simulation.world.lost_commands
        )

    @classmethod
    def at_rest(cls, simulation: Simulation, stance_rad: FloatArray, jammed_at_rad: FloatArray) -> Self:
        """The model of a robot that stands in its stance; `jammed_at_rad`, (18,), is for jammed joints."""
        jammed_rad = np.where(simulation.failed.jammed, jammed_at_rad, math.nan)
        return cls(simulation, stance_rad, stance_rad + simulation.joint_offsets_rad, jammed_rad)

    def copies(self, n: int) -> "ActuatorModel":
        """Model of n robots in this state, for targets (n, 18)."""
        heard_rad, shaft_rad = np.tile(self._heard_rad, (n, 1)), np.tile(self._shaft_rad, (n, 1))
        jammed_at_rad = np.tile(self._jammed_at_rad, (n, 1))
        return ActuatorModel(self._simulation, heard_rad, shaft_rad, jammed_at_rad)

    def leg_changed(
        self, leg: int, now_rad: FloatArray, commanded_rad: FloatArray, waiting_rad: FloatArray
    ) -> None:
        """Jam or free joints of a leg; angles and actuator commands have the leading shape + (18,).

        Commands that wait in the actuators are those of `simulation_model.waiting_commands`.
        """
        if self.plain:
            np.copyto(self.asked_rad, commanded_rad)
        joints = leg_slice(leg)
        jammed_at_rad = self._jammed_at_rad.copy()
        jammed = self._simulation.failed.jammed[joints]
        jammed_at_rad[..., joints] = np.where(jammed, now_rad[..., joints], math.nan)
        self._jam(jammed_at_rad)
        self.hold(waiting_rad)

    def hold(self, waiting_rad: FloatArray) -> None:
        """Replace waiting commands of jammed joints: a jam is no command and comes without delay."""
        jammed_rad = self._jammed_at_rad[..., np.newaxis]
        np.copyto(waiting_rad, jammed_rad, where=~np.isnan(jammed_rad))

    def drive(self, joint_positions_rad: FloatArray, lost: bool = False) -> FloatArray:
        """Actuator commands of one tick for joint targets, (18,) or (n, 18), which may be lost."""
        if lost:
            joint_positions_rad = self._heard_rad
        elif self._simulation.world.lost_commands:
            self._heard_rad = joint_positions_rad.copy()
        shaft_rad = joint_positions_rad + self._simulation.joint_offsets_rad
        if self._loose:
            shaft_rad = self._shaft_rad = behind_play(self._shaft_rad, shaft_rad, self._half_play_rad)
        np.copyto(self.asked_rad, shaft_rad)
        return np.where(self._obeys, shaft_rad, self._jammed_at_rad)
