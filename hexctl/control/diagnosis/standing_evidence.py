"""Evidence of a standing test: gains, contacts, torques and softness of each joint or leg."""

import math
from functools import cached_property

import numpy as np

from hexctl.control.diagnosis.standing_test import Observed, Section
from hexctl.types import (
    JOINTS_PER_LEG,
    N_JOINTS,
    N_LEGS,
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


class Evidence:
    """Measurements of a standing test so far; NaN if unknown; of joints (6, 3), of legs (6,)."""

    def __init__(self, observed: Observed) -> None:
        self._sections = [section for section in observed.sections if section.left_out is None]
        for section in self._sections:
            if section.stop <= section.start:
                section.stop = len(observed)
        self._known = observed.measured and len(observed) > 0
        self._measured, self._targets, self._contacts, self._torques = observed.columns()
        self._lag = self._best_lag() if self._known else 0

    @cached_property
    def gains(self) -> FloatArray:
        """Slope of each joint over its lagged target in the leg's lift, or else the sway; 0 for dead joints.

        The leg's other joints are fitted too: a dangling limp tibia, and a foot that drags the others, follow
        the targets of other joints.
        """
        gains = np.full((N_LEGS, JOINTS_PER_LEG), np.nan)
        for section in [*self._of("sway"), *self._of("lift")] if self._known else ():
            for leg in section.probe.legs:
                targets, measured = self._pair(section, leg_slice(leg))
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

    @property
    def follows(self) -> FloatArray:
        """Slope of each joint over its target in the sway."""
        products, squares, moved = self._sway
        return np.where(moved, products / np.maximum(squares, 1e-12), np.nan)

    @property
    def leg_follows(self) -> FloatArray:
        """Slope over the targets in the sway of all joints of a leg together."""
        products, squares, _ = self._sway
        return np.asarray(products.sum(axis=-1) / np.maximum(squares.sum(axis=-1), 1e-12))

    @cached_property
    def travel_rad(self) -> FloatArray:
        """Range of each joint in the complete test, 1st to 99th percentile."""
        if not self._known:
            return np.full((N_LEGS, JOINTS_PER_LEG), np.nan)
        low, high = np.percentile(self._measured, [1, 99], axis=0)
        return by_leg(np.asarray(high - low))

    @cached_property
    def lifted_contact(self) -> FloatArray:
        """Share of contact in the upper part of each foot's lift."""
        share = np.full(N_LEGS, np.nan)
        for section in self._of("lift"):
            length = section.stop - section.start
            if section.stopped is None and length >= LEAST_ROWS:
                up = slice(section.start + round(0.4 * length), section.start + round(0.75 * length))
                leg = section.probe.legs[0]
                share[leg - 1] = self._contacts[up, leg - 1].mean()
        return share

    @cached_property
    def standing_contact(self) -> FloatArray:
        """Share of contact while each foot is asked to stand."""
        share = np.full(N_LEGS, np.nan)
        stands: BoolArray = np.ones((len(self._contacts), N_LEGS), dtype=bool)
        for section in self._sections:
            for leg in section.probe.raised:
                stands[section.start : section.stop, leg - 1] = False
        for leg in range(N_LEGS) if len(stands) else ():
            if stands[:, leg].any():
                share[leg] = self._contacts[stands[:, leg], leg].mean()
        return share

    @cached_property
    def torque_rms_nm(self) -> FloatArray:
        """RMS torque of each joint."""
        if not len(self._torques):
            return np.full((N_LEGS, JOINTS_PER_LEG), np.nan)
        return by_leg(np.sqrt((self._torques**2).mean(axis=0)))

    @cached_property
    def servo_share(self) -> FloatArray:
        """Torque of each joint for a position error, as a share of that of the same joint in other legs.

        A servo gives k e - d v up to its limit, e its position error and v its speed. k is the median over
        the legs, the limit the maximum torque of any of them. The share s is fitted in

            torque = s clip(k e, -limit, limit) - d v + c

        The clip makes joints at their limit usable. s is 0 for limp joints, 1 for stuck ones, and about 0 for
        servos that do not try to reach their target.
        """
        if self._efforts is None:
            return np.full((N_LEGS, JOINTS_PER_LEG), np.nan)
        error, torque, speed = self._efforts
        error = error - error.mean(axis=0)
        slopes = np.array([_slope(error[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)])
        stiffness = np.tile(np.median(by_leg(slopes), axis=0), N_LEGS)
        limits = np.tile(by_leg(np.abs(torque).max(axis=0)).max(axis=0), N_LEGS)
        expected = np.clip(stiffness * error, -limits, limits)
        return by_leg(np.array([_slope(expected[:, j], torque[:, j], speed[:, j]) for j in range(N_JOINTS)]))

    @cached_property
    def softness(self) -> FloatArray:
        """Slope of position error over torque, as a multiple of its median over the legs.

        This slope averages out play and delay, unlike the slope of torque over error. Rows near a joint's
        maximum torque are left out.
        """
        slopes = np.full(N_JOINTS, np.nan)
        if self._efforts is None:
            return by_leg(slopes)
        error, torque, speed = self._efforts
        for joint in range(N_JOINTS):
            within = np.abs(torque[:, joint]) <= 0.9 * np.abs(torque[:, joint]).max()
            if within.sum() >= 2 * LEAST_ROWS and torque[within, joint].std() > 0:
                slopes[joint] = _slope(torque[within, joint], error[within, joint], speed[within, joint])
        finite = (column[np.isfinite(column)] for column in by_leg(slopes).T)
        usual = np.array([np.median(column) if column.size else np.nan for column in finite])
        return np.asarray(by_leg(slopes) / usual)

    def _best_lag(self) -> int:
        errors = [np.inf]
        for lag in range(1, min(MOST_LAG, len(self._measured) // 4) + 1):
            off = self._measured[lag:] - self._targets[:-lag]
            errors.append(float(np.median(off.var(axis=0))))
        return int(np.argmin(errors)) if len(errors) > 1 else 0

    def _of(self, kind: str) -> list[Section]:
        return [section for section in self._sections if section.probe.kind == kind]

    def _pair(self, section: Section, joints: slice) -> tuple[FloatArray, FloatArray]:
        """Lagged targets and measurements of joints in a section, (T, n) each, less their means."""
        stop = min(section.stop, len(self._measured) - self._lag)
        targets = self._targets[section.start : stop, joints]
        measured = self._measured[section.start + self._lag : stop + self._lag, joints]
        if len(targets) < LEAST_ROWS:
            return np.zeros((0, 0)), np.zeros((0, 0))
        return targets - targets.mean(axis=0), measured - measured.mean(axis=0)

    @cached_property
    def _sway(self) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Sums of targets times measurements, of squared targets, and which joints moved, (6, 3) each."""
        for section in self._of("sway") if self._known else ():
            targets, measured = self._pair(section, slice(0, N_JOINTS))
            if len(targets):
                products, squares = by_leg((targets * measured).sum(axis=0)), by_leg((targets**2).sum(axis=0))
                return products, squares, by_leg(targets.std(axis=0)) > LEAST_SPREAD_RAD / 2
        unknown = np.full((N_LEGS, JOINTS_PER_LEG), np.nan)
        return unknown, unknown, np.isfinite(unknown)

    @cached_property
    def _efforts(self) -> tuple[FloatArray, FloatArray, FloatArray] | None:
        """Position errors, torques and speeds of all joints, (T, 18) each; None if unknown."""
        lag = self._lag
        if not self._known or lag == 0 or not np.isfinite(self._torques).all():
            return None
        speed = np.gradient(self._measured, axis=0)[lag:]
        return self._targets[:-lag] - self._measured[lag:], self._torques[lag:], speed


def _slope(over: FloatArray, values: FloatArray, speed: FloatArray) -> float:
    """Slope of values over `over`, fitted together with speed and an offset."""
    design = np.stack([over, speed, np.ones(len(over))], axis=1)
    return float(np.linalg.lstsq(design, values, rcond=None)[0][0])
