"""Leg findings: the failure of each leg, with evidence, from the observations of a standing test."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.control.diagnosis.standing_evidence import Evidence
from hexctl.control.diagnosis.standing_test import Observed
from hexctl.robot.failure import UNKNOWN, Failure, failure_text, loses_leg
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS, BoolArray, FloatArray, leg_slice

#: A joint with a lower gain does not follow its target. If it does not follow the sway either while its servo
#: is active, it is stuck, or its leg locked.
DEAD_GAIN = 0.35
STUCK_GAIN = 0.12

#: An active joint is stuck only if it moves by less than this in the complete test, or its gain is below the
#: second number: an overloaded joint gives way.
STUCK_TRAVEL_RAD, NO_GAIN = math.radians(4.0), 0.03

#: A dead joint that follows the sway by more than this gives way: without torques it counts as limp.
LIMP_FOLLOW = 0.5

#: Below this share of the torque of the same joint in other legs, a joint has no torque.
NO_TORQUE_SHARE = 0.05

#: A servo with less than this share of the others' torque does not try to reach its target.
IDLE_SHARE = 0.2

#: A leg too weak to lift itself gives less than this share of the others' torque.
WEAK_SHARE = 0.55

#: A weak leg gives way more than the others by the first factor (geometric mean of femur and tibia), each
#: joint by the second, and gives less than this share of their torque.
WEAK_SOFTNESS, LEAST_SOFTNESS, WEAK_MEAN_SHARE = 1.75, 1.2, 0.7

#: A foot carries nothing if it has contact in less than this share of its stands. It did not rise if it has
#: contact in more than that share of the top of its lift.
NO_CONTACT_SHARE, STAYED_SHARE = 0.02, 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class LegFinding:
    """The diagnosis of one leg; values of coxa, femur and tibia are None if unknown.

    Attributes:
        failure: None if none was found.
        gains: slope of measured over commanded angle.
        load: share of its stance time with contact; None if unknown.
        torque_shares: torque as a share of the other legs'.
        tested: False if the motions that test it were stopped.
    """

    leg: int
    failure: Failure | None
    evidence: str
    gains: tuple[float | None, ...] = (None, None, None)
    load: float | None = None
    torque_shares: tuple[float | None, ...] = (None, None, None)
    tested: bool = True

    def to_dict(self) -> dict[str, Any]:
        """Finite JSON values."""
        return {
            "leg": self.leg,
            "failure": None if self.failure is None else str(self.failure),
            "evidence": self.evidence,
            "tested": self.tested,
            "gains": dict(zip(JOINT_KINDS, self.gains, strict=True)),
            "load": self.load,
            "torque_shares": dict(zip(JOINT_KINDS, self.torque_shares, strict=True)),
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class Diagnosis:
    """Result of a standing test.

    Attributes:
        source: of the evidence: `joints`, `contacts`, `operator` or `none`.
        notes: for the operator: stopped or omitted probes, and unknown values.
        unfinished: whether the test ended before any joint had moved far enough.
    """

    legs: tuple[LegFinding, ...]
    source: str
    notes: tuple[str, ...] = ()
    unfinished: bool = False

    @property
    def failures(self) -> tuple[Failure, ...]:
        """The failures found, by leg."""
        return tuple(finding.failure for finding in self.legs if finding.failure is not None)

    @property
    def verdict(self) -> str:
        """The failures in words, such as `leg 5 locked`."""
        if self.unfinished:
            return "not known: the test ended before it showed anything"
        if self.source == "none":
            return "not known: nothing that the robot tells shows its legs"
        untested = ", ".join(str(finding.leg) for finding in self.legs if not finding.tested)
        found = ", ".join(map(failure_text, self.failures)) or "no leg has failed"
        return f"{found}; not tested: leg {untested}" if untested else found

    def to_dict(self) -> dict[str, Any]:
        """Finite JSON values."""
        return {
            "verdict": self.verdict,
            "source": self.source,
            "failures": [{"leg": one.leg, "failure": str(one)} for one in self.failures],
            "legs": [finding.to_dict() for finding in self.legs],
            "notes": list(self.notes),
        }


def diagnosis_of(observed: Observed, robot: Robot) -> Diagnosis:
    """Diagnosis from joint positions if measured, with torques and contacts if known; else from contacts.

    The lean of the body is no evidence: on stiff floors and legs it hardly changes.
    """
    evidence = Evidence(observed)
    notes = _notes(observed)
    if observed.measured and np.isfinite(evidence.gains).any():
        judge = _Judge(evidence, observed.columns()[0], robot)
        findings = judge.findings()
        return Diagnosis(legs=findings, source="joints", notes=(*notes, *_gaps(evidence)))
    if observed.measured:
        return replace(_of_others(evidence, "none", {}, notes), unfinished=True)
    if np.isfinite(evidence.lifted_contact).any():
        why = "joint angles are not measured: judged by which feet leave the floor and meet it"
        return _of_others(evidence, "contacts", _by_contact(evidence), (*notes, why))
    why = "neither joint angles nor contacts are measured"
    return _of_others(evidence, "none", {}, (*notes, why))


def unsafe_legs(observed: Observed, robot: Robot) -> Mapping[int, str]:
    """Legs that must not carry a tripod by the observations so far, with the reason."""
    found = diagnosis_of(observed, robot).failures
    return {failure.leg: failure_text(failure) for failure in found if loses_leg(failure.kind)}


class _Judge:
    def __init__(self, evidence: Evidence, measured_rad: FloatArray, robot: Robot) -> None:
        self._seen, self._robot = evidence, robot
        self._angles_rad = np.median(measured_rad, axis=0)
        torques = evidence.torque_rms_nm
        self._efforts = bool(np.isfinite(torques).all() and torques.any())
        usual = np.median(torques, axis=0) if self._efforts else np.ones(JOINTS_PER_LEG)
        #: Joints without torque, (6, 3).
        self._idle: BoolArray = self._efforts & (torques < NO_TORQUE_SHARE * usual)

    def findings(self) -> tuple[LegFinding, ...]:
        """Findings for all legs. Weak legs are considered only if no leg has failed otherwise."""
        tested = [bool(np.isfinite(gains).any()) for gains in self._seen.gains]
        found = {leg: self._verdict(leg) for leg in range(1, N_LEGS + 1)}
        if self._efforts and not any(failure for failure, _ in found.values()):
            tried = [leg for leg in found if tested[leg - 1]]
            found |= {leg: weak for leg in tried if (weak := self._weak(leg)) is not None}
        return tuple(
            replace(_finding(self._seen, leg, *verdict), tested=tested[leg - 1])
            for leg, verdict in found.items()
        )

    def _verdict(self, leg: int) -> tuple[Failure | None, str]:
        row = leg - 1
        gains = self._seen.gains[row]
        if not np.isfinite(gains).any():
            return None, "not tested: its lift and the sway were stopped"
        dead = self._dead(row)
        contact = self._seen.standing_contact[row]
        if self._efforts and self._idle[row].all() and not dead.any():
            return Failure(leg=leg, kind="missing"), "its joints follow and bear nothing"
        if dead.sum() >= 2:
            return self._whole_leg(leg)
        if dead.any():
            return self._one_joint(leg, int(dead.argmax()))
        if not self._efforts and contact <= NO_CONTACT_SHARE:
            return Failure(leg=leg, kind="missing"), "its joints follow, its foot never meets the floor"
        if contact <= NO_CONTACT_SHARE:
            return None, "bears its load, but its foot shows no contact: look at the contact sensor"
        return None, "follows its targets"

    def _dead(self, row: int) -> BoolArray:
        """Which joints of a leg do not follow their targets, (3,)."""
        gains, follows, idle = self._seen.gains[row], self._seen.follows[row], self._idle[row]
        if not self._efforts:
            return np.asarray(gains < DEAD_GAIN)
        still = gains < STUCK_GAIN
        if np.count_nonzero(still) < 2:
            # A healthy foot that the load keeps on the floor still follows the sway. A locked leg may, too.
            rigid = (self._seen.travel_rad[row] < STUCK_TRAVEL_RAD) | (np.abs(gains) < NO_GAIN)
            still &= ~(follows >= STUCK_GAIN) & rigid
        return np.asarray(np.where(idle, gains < DEAD_GAIN, still))

    def _weak(self, leg: int) -> tuple[Failure, str] | None:
        """Failure of a leg whose joints follow but give way too much, or None."""
        softness, shares = self._seen.softness[leg - 1, 1:], self._seen.servo_share[leg - 1, 1:]
        if not (softness.min() > LEAST_SOFTNESS and _mean(softness) > WEAK_SOFTNESS):
            return None
        if not _mean(shares) < WEAK_MEAN_SHARE:
            return None
        failure = Failure(leg=leg, kind="weak", torque_fraction=_part(1 / _mean(softness)))
        return failure, f"gives way {_mean(softness):.1f} times as much as the other legs"

    def _whole_leg(self, leg: int) -> tuple[Failure | None, str]:
        row = leg - 1
        if not self._efforts:
            follows = self._seen.leg_follows[row]
            if follows > LIMP_FOLLOW:
                return Failure(leg=leg, kind="limp"), f"moves only as the body takes it along ({follows:.2f})"
            return Failure(leg=leg), "does not follow its targets, nor the sway"
        if self._idle[row].sum() >= 2:
            return Failure(leg=leg, kind="limp"), "does not follow its targets, its servos give no torque"
        share = float(np.median(self._seen.servo_share[row]))
        if IDLE_SHARE / 2 < share < WEAK_SHARE:
            weak = Failure(leg=leg, kind="weak", torque_fraction=_part(share))
            return weak, f"too weak to lift itself: {share:.0%} of the other legs' torque"
        if share >= WEAK_SHARE:
            return None, "its servos push and it does not move: something holds it, or its load is too great"
        return Failure(leg=leg), "does not follow its targets, its servos do not try to"

    def _one_joint(self, leg: int, joint: int) -> tuple[Failure, str]:
        row, kind = leg - 1, JOINT_KINDS[joint]
        follows = self._seen.follows[row, joint]
        if self._idle[row, joint] or (not self._efforts and follows > LIMP_FOLLOW):
            limp = Failure(leg=leg, kind="limp", joint=kind)
            told = "its servo gives no torque" if self._efforts else "it moves as the body takes it along"
            return limp, f"the {kind} does not follow its targets, {told}"
        index = leg_slice(leg).start + joint
        lower, upper = self._robot.joint_lower_rad[index], self._robot.joint_upper_rad[index]
        angle_rad = float(np.clip(self._angles_rad[index], lower, upper))
        stuck = Failure(leg=leg, kind="stuck", joint=kind, angle_rad=round(angle_rad, 3))
        pushes = ", its servo pushes" if self._efforts else ", nor the sway"
        return stuck, f"the {kind} stays at {math.degrees(angle_rad):.0f} degrees{pushes}"


def _mean(values: FloatArray) -> float:
    """Geometric mean; values of 0 or less count as 1e-6."""
    return math.exp(float(np.log(np.maximum(values, 1e-6)).mean()))


def _part(share: float) -> float:
    return round(min(max(share, 0.0), 1.0), 2)


def _by_contact(evidence: Evidence) -> dict[int, tuple[Failure, str]]:
    found: dict[int, tuple[Failure, str]] = {}
    for row in range(N_LEGS):
        leg = row + 1
        if evidence.standing_contact[row] <= NO_CONTACT_SHARE:
            found[leg] = Failure(leg=leg, kind=UNKNOWN), "its foot never meets the floor"
        elif evidence.lifted_contact[row] > STAYED_SHARE:
            found[leg] = Failure(leg=leg, kind=UNKNOWN), "its foot stays on the floor in its lift"
    return found


def _of_others(
    evidence: Evidence, source: str, found: Mapping[int, tuple[Failure, str]], notes: tuple[str, ...]
) -> Diagnosis:
    usual = "its foot leaves the floor and meets it" if source == "contacts" else "not known"
    legs = range(1, N_LEGS + 1)
    findings = (_finding(evidence, leg, *found.get(leg, (None, usual))) for leg in legs)
    return Diagnosis(legs=tuple(findings), source=source, notes=notes)


def _finding(evidence: Evidence, leg: int, failure: Failure | None, why: str) -> LegFinding:
    row = leg - 1
    return LegFinding(
        leg=leg,
        failure=failure,
        evidence=why,
        gains=tuple(map(_finite, evidence.gains[row])),
        load=_finite(evidence.standing_contact[row]),
        torque_shares=tuple(map(_finite, evidence.servo_share[row])),
    )


def _finite(value: float) -> float | None:
    return round(float(value), 3) if math.isfinite(value) else None


def _notes(observed: Observed) -> tuple[str, ...]:
    notes = []
    for section in observed.sections:
        if section.stopped is not None:
            notes.append(f"the {section.probe} was stopped: {section.stopped}")
        if section.left_out is not None:
            notes.append(f"the {section.probe} was left out: {section.left_out}")
    return tuple(notes)


def _gaps(evidence: Evidence) -> tuple[str, ...]:
    notes = []
    if not np.isfinite(evidence.torque_rms_nm).all():
        notes.append("torques are not measured: weak legs are not looked for")
        if not np.isfinite(evidence.standing_contact).any():
            notes.append("contacts are not measured either: nor are missing ones")
    return tuple(notes)


def reported_by_operator(diagnosis: Diagnosis, moved: Mapping[int, bool]) -> Diagnosis:
    """The diagnosis with the operator's observation whether each leg lifted, swung and stood again."""
    findings = tuple(
        replace(
            finding,
            failure=None if moved[finding.leg] else Failure(leg=finding.leg, kind=UNKNOWN),
            evidence=f"the operator saw it {'move' if moved[finding.leg] else 'not move as it should'}",
        )
        for finding in diagnosis.legs
    )
    return Diagnosis(legs=findings, source="operator", notes=diagnosis.notes)
