"""Evidence of a standing test: how each joint follows its target, what each leg bears, how it gives way."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.control.diagnosis.standing_test import Observed, Section
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, N_LEGS, ArrayFields, BoolArray, FloatArray, leg_slice

#: Longest time from a target to a measurement of it that is looked for, in control periods.
MOST_LAG = 10

#: A joint whose target varied by less than this, as a standard deviation, was not tested.
LEAST_SPREAD_RAD = math.radians(0.7)

#: A window shorter than this tells nothing.
LEAST_ROWS = 15


@dataclass(frozen=True, slots=True, eq=False)
class Evidence(ArrayFields):
    """What a standing test measured; NaN where it could not.

    Attributes:
        lag_ticks: time from a target to the measurement that follows it best.
        gains: slope of measured over lagged targets in the leg's lift, or in the sway where that was cut
            short; healthy joints have about 1, dead ones 0, (6, 3).
        follows: the slope over the sway of the targets that the body's motion asks of each joint, (6, 3).
        leg_follows: likewise of all three together, (6,).
        travel_rad: how far each joint moved in the whole test, without the extremes, (6, 3).
        lifted_contact: share of the upper part of its own lift in which each foot had contact, (6,).
        standing_contact: share of the rest of the test, without the tripods beside it, likewise, (6,).
        torque_rms_nm: of each joint's torque, (6, 3).
        servo_share: torque for a position error, as a share of what other legs give, (6, 3).
        softness: position error for a torque, as a multiple of what other legs have, (6, 3).
    """

    lag_ticks: int
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
        """Evidence of what was observed so far."""
        rows = _Rows(observed)
        torques = rows.torques
        return cls(
            lag_ticks=rows.lag,
            gains=_gains(rows),
            follows=_follows(rows),
            leg_follows=_leg_follows(rows),
            travel_rad=_travel_rad(rows),
            lifted_contact=_lifted_contact(rows),
            standing_contact=_standing_contact(rows),
            torque_rms_nm=_legs(np.sqrt((torques**2).mean(axis=0))) if len(torques) else _nan3(),
            servo_share=_servo_share(rows),
            softness=_softness(rows),
        )


class _Rows:
    """Arrays of what was observed, and its sections."""

    def __init__(self, observed: Observed) -> None:
        self.sections = [section for section in observed.sections if section.left_out is None]
        for section in self.sections:
            if section.stop <= section.start:
                section.stop = len(observed)
        self.known = observed.measured and len(observed) > 0
        self.measured, self.targets = observed.measured_rad, observed.targets_rad
        self.contacts, self.torques = observed.contacts, observed.torques_nm
        self.quaternions = observed.quaternions_world
        self.lag = self._best_lag() if self.known else 0

    def _best_lag(self) -> int:
        """Lag at which most joints follow best."""
        errors = [np.inf]
        for lag in range(1, min(MOST_LAG, len(self.measured) // 4) + 1):
            off = self.measured[lag:] - self.targets[:-lag]
            errors.append(float(np.median(off.var(axis=0))))
        return int(np.argmin(errors)) if len(errors) > 1 else 0

    def of(self, kind: str) -> list[Section]:
        """Sections of a kind."""
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


def _legs(values: FloatArray) -> FloatArray:
    return values.reshape(N_LEGS, JOINTS_PER_LEG)


def _gains(rows: _Rows) -> FloatArray:
    """Slope of each joint over its own target, those of the leg's other joints held, (6, 3).

    A limp tibia that dangles from a femur, and a foot that drags the others, follow other targets.
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


def _follows(rows: _Rows) -> FloatArray:
    """Slope of each joint over its target in the sway, (6, 3)."""
    follows = _nan3()
    for section in rows.of("sway") if rows.known else ():
        targets, measured = rows.pair(section, slice(0, N_JOINTS))
        if len(targets):
            squares = (targets**2).sum(axis=0)
            slopes = (targets * measured).sum(axis=0) / np.maximum(squares, 1e-12)
            follows = _legs(np.where(targets.std(axis=0) > LEAST_SPREAD_RAD / 2, slopes, np.nan))
    return follows


def _leg_follows(rows: _Rows) -> FloatArray:
    """Slope of the three joints of each leg together in the sway, (6,)."""
    for section in rows.of("sway") if rows.known else ():
        targets, measured = rows.pair(section, slice(0, N_JOINTS))
        if len(targets):
            products = (targets * measured).reshape(-1, N_LEGS, JOINTS_PER_LEG).sum(axis=(0, 2))
            squares = (targets**2).reshape(-1, N_LEGS, JOINTS_PER_LEG).sum(axis=(0, 2))
            return np.asarray(products / np.maximum(squares, 1e-12))
    return np.full(N_LEGS, np.nan)


def _travel_rad(rows: _Rows) -> FloatArray:
    """Range of each joint's angles without the hundredth at either end, (6, 3)."""
    if not rows.known:
        return _nan3()
    low, high = np.percentile(rows.measured, [1, 99], axis=0)
    return _legs(np.asarray(high - low))


def _upper(section: Section) -> slice:
    """Rows in which what a section raises is up, less the time that a state takes."""
    length = section.stop - section.start
    return slice(section.start + round(0.4 * length), section.start + round(0.75 * length))


def _lifted_contact(rows: _Rows) -> FloatArray:
    """Share of contact at the top of each leg's own lift, (6,)."""
    share = np.full(N_LEGS, np.nan)
    for section in rows.of("lift"):
        if section.stopped is None and section.stop - section.start >= LEAST_ROWS:
            leg = section.probe.legs[0]
            share[leg - 1] = rows.contacts[_upper(section), leg - 1].mean()
    return share


def _standing_contact(rows: _Rows) -> FloatArray:
    """Share of contact where each leg is asked to stand, (6,)."""
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
    """Torque of each joint as a share of what the same joint of the other legs would give, (6, 3).

    A servo gives k e - d v, e its position error and v its speed, up to its limit. With k the median over the
    legs and the limit the greatest torque of any of them, the share s is fitted in

        torque = s clip(k e, -limit, limit) - d v + c

    so that a joint at its limit tells as much as one that is not. A limp joint has 0, a weak one its part,
    one that is stuck 1, and one that does not even try to reach its target about 0.
    """
    lag = rows.lag
    if not rows.known or lag == 0 or not np.isfinite(rows.torques).all():
        return _nan3()
    error, torque = rows.targets[:-lag] - rows.measured[lag:], rows.torques[lag:]
    error = error - error.mean(axis=0)
    speed = np.gradient(rows.measured, axis=0)[lag:]
    slopes = np.array([_slope(error[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)])
    stiffness = np.tile(np.median(_legs(slopes), axis=0), N_LEGS)
    limits = np.tile(_legs(np.abs(torque).max(axis=0)).max(axis=0), N_LEGS)
    expected = np.clip(stiffness * error, -limits, limits)
    return _legs(np.array([_slope(expected[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)]))


def _softness(rows: _Rows) -> FloatArray:
    """Slope of position error over torque, as a multiple of its median over the legs, (6, 3).

    Play and delay are errors of the position, which this slope averages out, and the slope of torque over
    error does not. Rows near a joint's greatest torque are left out.
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
    finite = (column[np.isfinite(column)] for column in _legs(slopes).T)
    usual = np.array([np.median(column) if column.size else np.nan for column in finite])
    return np.asarray(_legs(slopes) / usual)


def _slope(over: FloatArray, values: FloatArray, speed: FloatArray) -> float:
    """Slope of values over others, speed and an offset fitted beside it."""
    design = np.stack([over, speed, np.ones(len(over))], axis=1)
    return float(np.linalg.lstsq(design, values, rcond=None)[0][0])
