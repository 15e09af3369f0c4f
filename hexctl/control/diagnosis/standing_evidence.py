"""Evidence of a standing test: gains, contacts, torques and softness of each joint or leg."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.control.diagnosis.standing_test import Observed, Section
from hexctl.types import (
    JOINTS_PER_LEG,
    N_JOINTS,
    N_LEGS,
    ArrayFields,
    BoolArray,
    FloatArray,
    by_leg,
    leg_slice,
)

#: Maximum lag from a target to its measurement, in control periods.
MOST_LAG = 10

#: A joint whose target has a smaller standard deviation was not tested.
LEAST_SPREAD_RAD = math.radians(0.7)

#: Minimum length of a window.
LEAST_ROWS = 15


@dataclass(frozen=True, slots=True, eq=False)
class Evidence(ArrayFields):
    """Measurements of a standing test; NaN if unknown; of joints (6, 3), of legs (6,).

    Attributes:
        gains: slope of measured over lagged targets in the leg's lift, or else the sway; dead joints have 0.
        follows: slope over the targets of the sway; of all joints of a leg together `leg_follows`.
        travel_rad: range in the complete test, 1st to 99th percentile.
        lifted_contact: share of contact in the upper part of each foot's lift.
        standing_contact: share of contact while the foot is asked to stand.
        servo_share: torque for a position error, as a share of the other legs'.
        softness: position error for a torque, as a multiple of the other legs'.
    """

    gains: FloatArray
    follows: FloatArray
    leg_follows: FloatArray
    travel_rad: FloatArray
    lifted_contact: FloatArray
    standing_contact: FloatArray
    torque_rms_nm: FloatArray
    servo_share: FloatArray
    softness: FloatArray

    @classmethod
    def of(cls, observed: Observed) -> "Evidence":
        """Evidence from the observations so far."""
        rows = _Rows(observed)
        torques, (follows, leg_follows) = rows.torques, _follows(rows)
        return cls(
            gains=_gains(rows),
            follows=follows,
            leg_follows=leg_follows,
            travel_rad=_travel_rad(rows),
            lifted_contact=_lifted_contact(rows),
            standing_contact=_standing_contact(rows),
            torque_rms_nm=by_leg(np.sqrt((torques**2).mean(axis=0))) if len(torques) else _nan3(),
            servo_share=_servo_share(rows),
            softness=_softness(rows),
        )


class _Rows:
    def __init__(self, observed: Observed) -> None:
        self.sections = [section for section in observed.sections if section.left_out is None]
        for section in self.sections:
            if section.stop <= section.start:
                section.stop = len(observed)
        self.known = observed.measured and len(observed) > 0
        self.measured, self.targets, self.contacts, self.torques = observed.columns()
        self.lag = self._best_lag() if self.known else 0

    def _best_lag(self) -> int:
        errors = [np.inf]
        for lag in range(1, min(MOST_LAG, len(self.measured) // 4) + 1):
            off = self.measured[lag:] - self.targets[:-lag]
            errors.append(float(np.median(off.var(axis=0))))
        return int(np.argmin(errors)) if len(errors) > 1 else 0

    def of(self, kind: str) -> list[Section]:
        return [section for section in self.sections if section.probe.kind == kind]

    def pair(self, section: Section, joints: slice) -> tuple[FloatArray, FloatArray]:
        """Lagged targets and measurements of joints in a section, (T, n) each, less their means."""
        stop = min(section.stop, len(self.measured) - self.lag)
        targets = self.targets[section.start : stop, joints]
        measured = self.measured[section.start + self.lag : stop + self.lag, joints]
        if len(targets) < LEAST_ROWS:
            return np.zeros((0, 0)), np.zeros((0, 0))
        return targets - targets.mean(axis=0), measured - measured.mean(axis=0)


def _nan3() -> FloatArray:
    return np.full((N_LEGS, JOINTS_PER_LEG), np.nan)


def _gains(rows: _Rows) -> FloatArray:
    """Slope of each joint over its own target, with the leg's other joints fitted, (6, 3).

    A dangling limp tibia, and a foot that drags the others, follow the targets of other joints.
    """
    gains = _nan3()
    if not rows.known:
        return gains
    for section in [*rows.of("sway"), *rows.of("lift")]:
        for leg in section.probe.legs:
            targets, measured = rows.pair(section, leg_slice(leg))
            if not len(targets) or section.stopped is not None:
                continue
            tested = np.flatnonzero(targets.std(axis=0) > LEAST_SPREAD_RAD)
            if section.probe.kind == "sway":
                tested = tested[np.isnan(gains[leg - 1, tested])]
                slopes = (targets * measured).sum(axis=0) / np.maximum((targets**2).sum(axis=0), 1e-12)
                gains[leg - 1, tested] = slopes[tested]
            elif tested.size:
                fit = np.linalg.lstsq(targets[:, tested], measured[:, tested], rcond=None)[0]
                gains[leg - 1, tested] = np.diag(fit)
    return gains


def _follows(rows: _Rows) -> tuple[FloatArray, FloatArray]:
    """Slopes over the targets of the sway, of joints, (6, 3), and of legs, (6,)."""
    for section in rows.of("sway") if rows.known else ():
        targets, measured = rows.pair(section, slice(0, N_JOINTS))
        if len(targets):
            products, squares = by_leg((targets * measured).sum(axis=0)), by_leg((targets**2).sum(axis=0))
            moved = by_leg(targets.std(axis=0)) > LEAST_SPREAD_RAD / 2
            slopes = np.where(moved, products / np.maximum(squares, 1e-12), np.nan)
            return slopes, products.sum(axis=-1) / np.maximum(squares.sum(axis=-1), 1e-12)
    return _nan3(), np.full(N_LEGS, np.nan)


def _travel_rad(rows: _Rows) -> FloatArray:
    if not rows.known:
        return _nan3()
    low, high = np.percentile(rows.measured, [1, 99], axis=0)
    return by_leg(np.asarray(high - low))


def _upper(section: Section) -> slice:
    """Rows in which the raised legs of a section are up."""
    length = section.stop - section.start
    return slice(section.start + round(0.4 * length), section.start + round(0.75 * length))


def _lifted_contact(rows: _Rows) -> FloatArray:
    share = np.full(N_LEGS, np.nan)
    for section in rows.of("lift"):
        if section.stopped is None and section.stop - section.start >= LEAST_ROWS:
            leg = section.probe.legs[0]
            share[leg - 1] = rows.contacts[_upper(section), leg - 1].mean()
    return share


def _standing_contact(rows: _Rows) -> FloatArray:
    if not len(rows.contacts):
        return np.full(N_LEGS, np.nan)
    stands: BoolArray = np.ones(rows.contacts.shape, dtype=bool)
    for section in rows.sections:
        for leg in section.probe.raised:
            stands[section.start : section.stop, leg - 1] = False
    share = np.full(N_LEGS, np.nan)
    for leg in range(N_LEGS):
        if stands[:, leg].any():
            share[leg] = rows.contacts[stands[:, leg], leg].mean()
    return share


def _servo_share(rows: _Rows) -> FloatArray:
    """Torque of each joint as a share of that of the same joint in other legs, (6, 3).

    A servo gives k e - d v up to its limit, e its position error and v its speed. k is the median over the
    legs, the limit the maximum torque of any of them. The share s is fitted in

        torque = s clip(k e, -limit, limit) - d v + c

    The clip makes joints at their limit usable. s is 0 for limp joints, 1 for stuck ones, and about 0 for
    servos that do not try to reach their target.
    """
    lag = rows.lag
    if not rows.known or lag == 0 or not np.isfinite(rows.torques).all():
        return _nan3()
    error, torque = rows.targets[:-lag] - rows.measured[lag:], rows.torques[lag:]
    error = error - error.mean(axis=0)
    speed = np.gradient(rows.measured, axis=0)[lag:]
    slopes = np.array([_slope(error[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)])
    stiffness = np.tile(np.median(by_leg(slopes), axis=0), N_LEGS)
    limits = np.tile(by_leg(np.abs(torque).max(axis=0)).max(axis=0), N_LEGS)
    expected = np.clip(stiffness * error, -limits, limits)
    return by_leg(np.array([_slope(expected[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)]))


def _softness(rows: _Rows) -> FloatArray:
    """Slope of position error over torque, as a multiple of its median over the legs, (6, 3).

    This slope averages out play and delay, unlike the slope of torque over error. Rows near a joint's maximum
    torque are left out.
    """
    lag = rows.lag
    if not rows.known or lag == 0 or not np.isfinite(rows.torques).all():
        return _nan3()
    error, torque = rows.targets[:-lag] - rows.measured[lag:], rows.torques[lag:]
    speed = np.gradient(rows.measured, axis=0)[lag:]
    slopes = np.full(N_JOINTS, np.nan)
    for joint in range(N_JOINTS):
        within = np.abs(torque[:, joint]) <= 0.9 * np.abs(torque[:, joint]).max()
        if within.sum() >= 2 * LEAST_ROWS and torque[within, joint].std() > 0:
            slopes[joint] = _slope(torque[within, joint], error[within, joint], speed[within, joint])
    finite = (column[np.isfinite(column)] for column in by_leg(slopes).T)
    usual = np.array([np.median(column) if column.size else np.nan for column in finite])
    return np.asarray(by_leg(slopes) / usual)


def _slope(over: FloatArray, values: FloatArray, speed: FloatArray) -> float:
    """Slope of values over `over`, fitted together with speed and an offset."""
    design = np.stack([over, speed, np.ones(len(over))], axis=1)
    return float(np.linalg.lstsq(design, values, rcond=None)[0][0])
