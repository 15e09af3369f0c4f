"""The parameters of servos and trunk that an identification may change."""

from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, FloatArray


@dataclass(frozen=True, slots=True)
class Estimate:
    """One identified parameter.

    Attributes:
        deviation: standard error of the value, in its unit; infinite if the value has no effect on the logs.
        known: whether the logs determine the value.
    """

    value: float
    deviation: float
    unit: str
    known: bool

    def to_dict(self) -> dict[str, Any]:
        """JSON values: an infinite deviation is None."""
        return asdict(self) | {"deviation": self.deviation if np.isfinite(self.deviation) else None}


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number to be identified, with bounds in which the physics make sense.

    Attributes:
        name: a field of `RobotValues`.
        unit: for reports.
        step: change by which its effect is measured: a share of the value, or in the unit.
        absolute: whether `step` and `known_to` are in the unit, not shares of the value.
        scaled: searched as a multiple of the stiffness.
        known_to: maximum standard error of a known value.
    """

    name: str
    unit: str
    low: float
    high: float
    step: float = 0.05
    absolute: bool = False
    scaled: bool = False
    known_to: float = 1 / 3

    def estimate(self, value: float, deviation: float) -> Estimate:
        """Estimate with a standard error in the unit."""
        largest = self.known_to if self.absolute else self.known_to * abs(value)
        return Estimate(value, deviation, self.unit, deviation < largest)


#: In the order of reports. The bounds only keep a search where the simulation works, far from any servo:
#: rotor inertias of 0.001 to 0.033 kg m2 are published. Simulations keep commands for the longest dead time.
#: All torques and masses together change a motion little, each of them changes it much: they are searched as
#: multiples of the stiffness. A motion is nearly linear in these multiples. Steps are
#: large, because what sticks and slips moves at random on a small scale. Torque is in a data sheet and mass
#: weighed: values with an error above a tenth replace neither.
PARAMETERS = {
    one.name: one
    for one in (
        Parameter("stiffness_nm_per_rad", "N m/rad", 1e-3, 1e3, step=0.1),
        Parameter("damping_nm_s_per_rad", "N m s/rad", 1e-4, 20.0, scaled=True),
        Parameter("rotor_inertia_kg_m2", "kg m2", 1e-5, 0.5, scaled=True),
        Parameter("dry_friction_nm", "N m", 1e-4, 5.0, scaled=True),
        Parameter("load_friction", "share", 0.0, 0.9, step=0.03, absolute=True, known_to=0.1),
        Parameter("gear_damping_nm_s_per_rad", "N m s/rad", 1e-4, 5.0, scaled=True),
        Parameter("max_torque_nm", "N m", 1e-2, 50.0, scaled=True, known_to=0.1),
        Parameter("no_load_speed_rad_s", "rad/s", 0.5, 50.0),
        Parameter("dead_time_s", "s", 0.0, 0.06, step=0.002, absolute=True, known_to=0.005),
        Parameter("coxa_stiffness_ratio", "times tibia", 0.05, 20.0, step=0.1),
        Parameter("femur_stiffness_ratio", "times tibia", 0.05, 20.0, step=0.1),
        Parameter("play_deg", "deg", 0.0, 10.0, step=0.1, absolute=True, known_to=0.2),
        Parameter("trunk_mass_kg", "kg", 1e-3, 100.0, scaled=True, known_to=0.1),
        Parameter("trunk_com_x_m", "m", -0.5, 0.5, step=0.005, absolute=True, known_to=0.005),
        Parameter("trunk_com_y_m", "m", -0.5, 0.5, step=0.005, absolute=True, known_to=0.005),
    )
}

#: By which `scaled` parameters are divided.
SCALE = "stiffness_nm_per_rad"


@dataclass(frozen=True, slots=True)
class ServoValues:
    """One servo model, in the form of `ServoModel`: torque = stiffness * error - damping * speed, limited.

    Attributes:
        stiffness_nm_per_rad: of the reference joint or, of servos on a bench, per unit of their P gain.
        no_load_speed_rad_s: infinite without back-EMF.
    """

    stiffness_nm_per_rad: float
    damping_nm_s_per_rad: float
    rotor_inertia_kg_m2: float
    dry_friction_nm: float
    load_friction: float
    gear_damping_nm_s_per_rad: float
    max_torque_nm: float
    no_load_speed_rad_s: float
    dead_time_s: float

    @classmethod
    def of(cls, robot: Robot) -> "ServoValues":
        """Values of a robot file; those of single joint kinds by their means."""
        speeds, servo = robot.joint_no_load_speed_rad_s, robot.servo
        return ServoValues(
            stiffness_nm_per_rad=float(robot.stiffness_nm_per_rad.mean()),
            damping_nm_s_per_rad=servo.damping_nm_s_per_rad,
            rotor_inertia_kg_m2=servo.rotor_inertia_kg_m2,
            dry_friction_nm=float(robot.dry_friction_nm.mean()),
            load_friction=servo.load_friction,
            gear_damping_nm_s_per_rad=servo.gear_damping_nm_s_per_rad,
            max_torque_nm=float(robot.joint_max_torque_nm.mean()),
            no_load_speed_rad_s=np.inf if speeds is None else float(speeds.mean()),
            dead_time_s=servo.dead_time_s,
        )

    @property
    def back_emf_nm_s_per_rad(self) -> float:
        """Torque lost per speed with power."""
        return self.max_torque_nm / self.no_load_speed_rad_s


@dataclass(frozen=True, slots=True)
class RobotValues(ServoValues):
    """The servos of a robot by joint kind, and the mass of its trunk with its centre in the body frame.

    Attributes:
        coxa_stiffness_ratio, femur_stiffness_ratio: stiffness as a multiple of the tibia's.
        play_deg: mean backlash of the joints, from stop to stop.
    """

    coxa_stiffness_ratio: float
    femur_stiffness_ratio: float
    play_deg: float
    trunk_mass_kg: float
    trunk_com_x_m: float
    trunk_com_y_m: float

    @classmethod
    def of(cls, robot: Robot) -> "RobotValues":
        """Values of a robot file."""
        com_x_m, com_y_m, _ = robot.body.com_m
        coxa, femur, tibia = robot.stiffness_nm_per_rad[:JOINTS_PER_LEG].tolist()
        return RobotValues(
            **asdict(ServoValues.of(robot)),
            coxa_stiffness_ratio=coxa / tibia,
            femur_stiffness_ratio=femur / tibia,
            play_deg=float(np.degrees(robot.play_rad.mean())),
            trunk_mass_kg=robot.body.mass_kg,
            trunk_com_x_m=com_x_m,
            trunk_com_y_m=com_y_m,
        )

    @property
    def kind_stiffnesses_nm_per_rad(self) -> tuple[float, float, float]:
        """Stiffness of coxa, femur and tibia; their mean is `stiffness_nm_per_rad`."""
        ratios = self.coxa_stiffness_ratio, self.femur_stiffness_ratio, 1.0
        tibia = JOINTS_PER_LEG * self.stiffness_nm_per_rad / sum(ratios)
        coxa, femur, _ = (tibia * ratio for ratio in ratios)
        return coxa, femur, tibia


def play_shares(robot: Robot) -> FloatArray:
    """Play of each joint, (18,), as a multiple of the mean; alike if the robot file has none."""
    play_rad = robot.play_rad
    return play_rad / play_rad.mean() if play_rad.any() else np.ones(N_JOINTS)


#: Names of the parameters of servos and of a trunk.
OF_SERVO = tuple(field.name for field in fields(ServoValues))
OF_TRUNK = tuple(field.name for field in fields(RobotValues) if field.name.startswith("trunk_"))
