"""A policy walked for ten seconds in simulation, and what looks wrong about it."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hexctl.control.log import TickLog
from hexctl.control.policy.contract import PolicyContract, Term
from hexctl.control.policy.description import problems
from hexctl.control.policy.policy import Policy
from hexctl.control.trace import PHASES
from hexctl.ik.legs import feet_of_joint_angles
from hexctl.robot.model import Robot
from hexctl.runs.run import RunResult, run
from hexctl.runs.run_spec import RunSpec
from hexctl.types import JOINT_NAMES, N_LEGS, FloatArray, joint_in_words

#: Statuses that say by themselves what happened.
FATES = {"fell": "fell", "diverged": "was thrown about (the simulation diverged)"}

#: Share of ticks with an action at a limit, or with targets faster than the joints.
OFTEN = 0.2

#: Largest first step of a joint from the default pose.
JUMP_RAD = 0.35

#: Largest scaled number of an observation that networks are trained with.
LARGE = 30.0

#: Differences between ticks whose differences are as large as these are shaking, if they exceed an angle.
SHAKE, SHAKE_RAD = 1.4, 0.05

#: Shares of the commanded distance below and above which a walk is not the commanded one.
SLOW, FAST = 0.4, 1.7

#: Turn in a second of a straight walk, sideways share of the way, and lean that are too much.
TURN_DEG_S, SIDEWAYS, LEAN_DEG = 4.0, 0.5, 8.0

#: Share of a typical foot's way at which a foot on the floor goes against the others.
AGAINST = 0.3


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyCheck:
    """What looks wrong about a policy.

    Attributes:
        findings: sentences; empty if nothing does.
        outcome: of the walk, as `hexctl run --json` prints it; None if the contract does not match the robot.
    """

    findings: tuple[str, ...]
    outcome: dict[str, Any] | None

    def to_dict(self) -> dict[str, Any]:
        """JSON values."""
        return {"findings": list(self.findings), "outcome": self.outcome}


def check_policy(policy: Policy, robot: Robot, spec: RunSpec) -> PolicyCheck:
    """Walk a policy as a spec has it, without a recording, and judge contract and walk."""
    found = tuple(problems(policy, robot))
    if found:
        return PolicyCheck(findings=found, outcome=None)
    done = run(replace(spec, policy=policy, robot=robot, record=None, record_folder=None))
    return PolicyCheck(findings=tuple(_Judge(policy.contract, robot, done).findings()), outcome=done.outcome)


class _Judge:
    def __init__(self, contract: PolicyContract, robot: Robot, done: RunResult) -> None:
        self._contract, self._robot, self._done = contract, robot, done
        log: TickLog = done.log
        self._walked = np.zeros(len(log), dtype=bool)
        if log.own_columns:
            self._observations = log["policy_observation"]
            self._walked = np.isfinite(self._observations[:, 0]) & (log["phase"] == PHASES.index("walk"))

    def findings(self) -> Iterator[str]:
        done, log = self._done, self._done.log
        if done.trial.status in FATES:
            yield f"the robot {FATES[done.trial.status]} after {done.trial.duration_s:.1f} s"
        if done.trial.stopped is not None:
            yield f"the walk was stopped: {done.trial.stopped}"
        if not self._walked.any():
            yield "the policy did not walk"
            return
        self._targets_rad = log["requested_rad"][self._walked]
        yield from self._saturated()
        yield from self._first_action()
        yield from self._observed()
        yield from self._shaking()
        if done.trial.status not in FATES:
            yield from self._course()
            yield from self._legs()

    def _saturated(self) -> Iterator[str]:
        shares = self._done.outcome["policy"]["saturated"]
        often = [joint for joint, share in shares.items() if share > OFTEN]
        if often:
            most = max(shares.values())
            yield f"actions are at limits for up to {most:.0%} of the time: {_few(often)}; check the scale"
        clipped = self._done.trial.clipped_ticks / max(1, int(self._walked.sum()))
        if clipped > OFTEN:
            share = min(1.0, clipped)
            yield f"targets move faster than the joints for {share:.0%} of the time; check the scale"

    def _first_action(self) -> Iterator[str]:
        default_rad = self._contract.joints_rad(self._contract.default_rad)
        jump_rad = np.abs(self._targets_rad[0] - default_rad)
        if jump_rad.max() > JUMP_RAD:
            joint, angle = int(jump_rad.argmax()), math.degrees(float(jump_rad.max()))
            name = joint_in_words(joint)
            yield f"the first action moves {name} by {angle:.0f} degrees; check scale and offset"

    def _observed(self) -> Iterator[str]:
        names, seen = self._contract.observation_names, self._observations[self._walked]
        for term in self._contract.terms:
            places = [place for place, name in enumerate(names) if _is_of(name, term)]
            values = seen[:, places]
            most = float(np.abs(values).max())
            if most > LARGE:
                yield f"{term.name} reaches {most:.0f} after its scale; check its scale and unit"
            if self._measured(term) and float(np.ptp(values, axis=0).max()) < 1e-9:
                yield f"{term.name} never changes; check that the robot measures it"

    def _measured(self, term: Term) -> bool:
        return term.stand_in is None and term.kind not in ("command", "gait_phase")

    def _shaking(self) -> Iterator[str]:
        steps = np.diff(self._targets_rad, axis=0)
        if len(steps) < 3:
            return
        rough, plain = (np.sqrt((part**2).mean(axis=0)) for part in (np.diff(steps, axis=0), steps))
        shakes = (rough > SHAKE * plain) & (plain > SHAKE_RAD)
        if shakes.any():
            names = [JOINT_NAMES[joint] for joint in np.flatnonzero(shakes).tolist()]
            yield f"targets go back and forth from tick to tick: {_few(names)}; check the scales of terms"

    def _course(self) -> Iterator[str]:
        trial, seconds = self._done.trial, int(self._walked.sum()) * 0.02
        forward, left, turn = self._done.outcome["policy"]["velocity_body"]
        way_m = math.hypot(forward, left) * (seconds - 0.5)
        distance_m = trial.distance_m if trial.true_distance_m is None else trial.true_distance_m
        if way_m > 0 and distance_m is not None and not turn:
            share = distance_m / way_m
            if not SLOW < share < FAST:
                how = "backwards, " if share < -0.1 else ""
                yield f"it walks {how}{distance_m:.2f} m, and {way_m:.2f} m were commanded"
            off = trial.true_deviation or trial.deviation
            if off is not None and abs(off.signed) > SIDEWAYS * way_m:
                yield f"it ends {abs(off.signed):.2f} m {'left' if off.signed > 0 else 'right'} of its line"
        if trial.yaw_change_rad is not None:
            turned = math.degrees(trial.yaw_change_rad) / seconds
            if abs(turned - math.degrees(turn)) > max(TURN_DEG_S, 0.7 * abs(math.degrees(turn))):
                yield f"it turns at {turned:.1f} degrees/s, and {math.degrees(turn):.1f} were commanded"
        if trial.tilt_deg is not None and trial.tilt_deg > LEAN_DEG:
            yield f"the body leans by {trial.tilt_deg:.0f} degrees (RMS)"

    def _legs(self) -> Iterator[str]:
        """Legs whose feet on the floor move against the way of the others."""
        forward, left, _ = self._done.outcome["policy"]["velocity_body"]
        if not (forward or left):
            return
        log, robot = self._done.log, self._robot
        rows = np.flatnonzero(self._walked)
        feet = feet_of_joint_angles(robot, log["measured_rad"][rows])  # (T, 6, 3)
        ahead = (feet[..., 0] * forward + feet[..., 1] * left) / math.hypot(forward, left)
        moved = np.diff(ahead, axis=0) * (np.diff(rows) == 1)[:, np.newaxis]
        low = feet[1:, :, 2] <= np.median(feet[:, :, 2], axis=0) + 1e-4
        ways: FloatArray = (moved * low).sum(axis=0)  # of each leg, backwards below 0
        usual = float(np.median(ways))
        against = [leg + 1 for leg in range(N_LEGS) if ways[leg] * np.sign(usual) < -AGAINST * abs(usual)]
        if usual < 0 and against:
            legs = ", ".join(map(str, against))
            yield f"the feet of leg {legs} push against the others; check the directions of their joints"


def _is_of(name: str, term: Term) -> bool:
    start, _, rest = name.rpartition(f"{term.name}_")
    return start == "" and name.startswith(f"{term.name}_") and rest.partition("_ago")[0].isdigit()


def _few(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
