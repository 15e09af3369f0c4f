"""A walk that detects failed legs, and follows its recovery's response."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.control.controllers import Controller, Walk
from hexctl.control.monitor.leg_monitor import SETTLED, LegMonitor, Suspicion
from hexctl.control.monitor.leg_probe import AFTER_RELAPSE, FIRST_CYCLES, LegProbe
from hexctl.control.monitor.leg_signatures import leg_patterns, shipped_signatures
from hexctl.control.monitor.posture_trial import PostureTrial
from hexctl.control.monitor.recovery import (
    MOST_RECOVERED,
    GlideToStableGait,
    Recovery,
    Response,
    StopWalking,
    WalkOn,
)
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import planned_walk
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.control.walks.velocity_walk import MotionWalk, VelocityWalk
from hexctl.errors import check_type
from hexctl.gait.gait import Gait, ideal_speed_m_s
from hexctl.robot.failure import ON_TRIAL, Failure, NoticedFailure
from hexctl.robot.plugins import label_of, show_traceback, why
from hexctl.types import N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState, leg_slice

#: Cycles after a detection when the kind of failure is evaluated again; the second time, after the targets of
#: all joints have moved, only to distinguish locked legs from stuck joints.
KIND_AFTER_CYCLES, LOCKED_AFTER_CYCLES = 0.4, 1.5

#: Of three legs accused within so many cycles, those that do not follow are overloaded: the others no longer
#: carry.
TOGETHER_CYCLES = 2.0

#: Trial in cycles of a missing leg after it is put down: by then missing load is detected.
TRIAL_CYCLES = 3.0

LEGS = np.arange(1, N_LEGS + 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Noticed:
    """A failure that a walk has detected, and its response; healed ones name the earlier suspicion."""

    suspicion: Suspicion
    response: Response
    healed: bool = False


class MonitoredWalk(Controller):
    """Monitors the legs of a walk, and follows a recovery; only a `VelocityWalk` changes its gait."""

    def __init__(self, start: WalkStart, walk: Controller, recovery: Recovery) -> None:
        self.walk, self.hold = walk, walk.hold
        self._start, self._recovery, self._plans = start, recovery, list(start.plans)
        if isinstance(walk, VelocityWalk):
            walk.suited = self._suited
        self._headings_rad = [motion.heading_rad for motion in start.motions]
        self._failures = [list(plan.failures) for plan in start.plans]
        self.noticed: tuple[list[Noticed], ...] = tuple([] for _ in start.plans)
        self.change_recovery(recovery)
        self._stopping = False
        self._stopped: dict[int, str] = {}
        self._trouble = ""  # error of the recovery
        self._unsettled: list[tuple[int, int, int, float]] = []
        self._probes: dict[tuple[int, int], LegProbe] = {}
        self._first_tries: dict[tuple[int, int], float] = {}
        self._trials: dict[tuple[int, int], tuple[float, Failure]] = {}
        self._posture_trials: dict[int, PostureTrial] = {}
        self._sent_rad: FloatArray = np.zeros((*start.batch_shape, N_JOINTS))
        self._news: Sequence[str] = ()
        if not start.reports_load and _steady(walk):
            shipped_signatures()  # not in a tick: it takes long, and the file may be damaged
        self._monitor = LegMonitor(
            start.robot,
            start.batch_shape,
            start.period_s,
            self._each([plan.gait.pace_hz for plan in start.plans]),
            self._each([np.isin(LEGS, plan.failed_legs) for plan in start.plans]),
            self._patterns_of if _steady(walk) else None,
            uneven=start.plans[0].feet == "adaptive",
        )

    def change_recovery(self, recovery: Recovery) -> None:
        """Follow another recovery for legs that fail from now on, which it prepares."""
        for plan, heading_rad in zip(self._start.plans, self._headings_rad, strict=True):
            recovery.prepare(self._start.robot, plan, heading_rad)
        self._recovery = recovery

    def _each(self, values: Sequence[Any]) -> Any:
        return np.array(values)[slice(None) if self._start.batch_shape else 0]

    def _patterns_of(self, leg: int, seen: str) -> FloatArray:
        """Patterns of a leg, 1..6, in the initial gaits of the walks (`BodyBalance`)."""
        robot, plans = self._start.robot, self._start.plans
        return np.asarray(self._each([leg_patterns(robot, plan.gait, leg, seen) for plan in plans]))

    @property
    def velocity_body(self) -> FloatArray | None:  # type: ignore[override]  # forwarded
        """Current velocity, leading shape + (3,)."""
        return self.walk.velocity_body

    @property
    def limited_steps(self) -> "NDArray[np.int64] | int":  # type: ignore[override]  # forwarded
        """Steps in which the commanded speed exceeded the strokes, leading shape."""
        return self.walk.limited_steps

    @property
    def leg_phases(self) -> FloatArray | None:  # type: ignore[override]  # forwarded
        """Normalised times of the legs in the last step, leading shape + (6,)."""
        return self.walk.leg_phases

    @property
    def leg_suspicion(self) -> FloatArray | None:  # type: ignore[override]  # of the monitor
        """Evidence against each leg, an alarm at 1, leading shape + (6,); None in the soft stop."""
        return None if self._stopping else self._monitor.ratio

    def known_failures(self, index: int = 0) -> tuple[Failure, ...]:
        """Failures given by the plan and detected, by leg."""
        return tuple(sorted(self._failures[index], key=lambda one: one.leg))

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        if (phases := self.walk.leg_phases) is None:
            self._monitor.rests(state)
        elif not self._stopping:
            self._monitor.update(state, phases)
            if np.count_nonzero(self._monitor.new):  # half the time of `any`
                self._respond(step)
            if self._monitor.weakened:
                self._report_weak(step)
            for due in [due for due in self._unsettled if step >= due[0]]:
                self._unsettled.remove(due)
                self._settle_kind(*due[1:])
            if self._probes:
                self._try_legs(step, state)
            if self._posture_trials:
                self._try_postures(state)
        targets_rad = self._sent_rad = self.walk.targets_rad(step, state)
        self._monitor.sent(targets_rad, state.age_s)
        return targets_rad

    def done(self, step: int, state: RobotState) -> bool | BoolArray:
        """Whether the walk has ended, or its recovery stops it, leading shape."""
        if not self._stopped:
            return self.walk.done(step, state)
        by_recovery = self._each([index in self._stopped for index in range(len(self.noticed))])
        return np.asarray(by_recovery | self.walk.done(step, state))

    def why_stopped(self, index: int = 0) -> str | None:
        """The failure for which the recovery has stopped a walk, or why it ended by itself; else None."""
        return self._stopped.get(index, self.walk.why_stopped(index))

    def walk_on(self) -> None:
        """Continue although the recovery has stopped walks; failed legs stay known."""
        self._stopped.clear()
        self._unsettled.clear()  # a new evaluation of the kind would stop it again

    def stop(self, step: int) -> int:
        """Begin the soft stop, without monitoring; the steps that it takes."""
        self._stopping = True
        return self.walk.stop(step)

    def noticed_failures(self, index: int = 0) -> tuple[NoticedFailure, ...]:
        """Failures detected so far, of one robot of a batch."""
        return tuple(
            NoticedFailure(
                at_s=each.suspicion.step * self._start.period_s,
                failure=each.suspicion.failure,
                evidence=each.suspicion.evidence,
                did=str(each.response),
                healed=each.healed,
                torque_error=each.suspicion.error,
            )
            for each in self.noticed[index]
        )

    def news(self) -> Sequence[str]:
        """Detections since the last call."""
        news, self._news = self._news, ()
        return news

    def _tell(self, *lines: str) -> None:
        self._news = (*self._news, *lines)

    def _row(self, index: int) -> tuple[int, ...]:
        return (index,) if self._start.batch_shape else ()

    def _cycle_steps(self, index: int) -> float:
        return 1 / (self._start.plans[index].gait.pace_hz * self._start.period_s)

    def _respond(self, step: int) -> None:
        responses: dict[int, Response] = {}
        for index in np.flatnonzero(self._monitor.new.any(axis=-1)).tolist():
            if index in self._stopped:
                continue
            suspicion = self._monitor.suspicion(step, self._row(index))
            if self._clears_overloaded(index, suspicion):
                continue
            self._failures[index].append(suspicion.failure)
            self._tell(f"noticed: {suspicion}, by {suspicion.evidence}")
            failed_trials = self._end_trials(index, suspicion)
            response = self._answer(index, self._failures[index])
            self.noticed[index].append(Noticed(suspicion=suspicion, response=response))
            for again in failed_trials:
                self.noticed[index].append(Noticed(suspicion=again, response=response))
                self._try_later(index, again)
            self._tell(*response.lines)
            responses[index] = response
            if response.stop:
                self._stopped[index] = f"{suspicion}; {self._trouble}" if self._trouble else str(suspicion)
            self._settle_later(index, len(self.noticed[index]) - 1 - len(failed_trials), KIND_AFTER_CYCLES)
            self._try_later(index, suspicion)
        self._glide(responses)

    def _clears_overloaded(self, index: int, suspicion: Suspicion) -> bool:
        """Take back accusations of overloaded legs; True if this leg is overloaded too."""
        since_step = suspicion.step - TOGETHER_CYCLES * self._cycle_steps(index)
        together = {
            one.suspicion.leg: one.suspicion
            for one in self.noticed[index]
            if not one.healed
            and one.suspicion.step >= since_step
            and one.suspicion.failure in self._failures[index]
        }
        if len(together) < MOST_RECOVERED:
            return False
        for leg, accusation in together.items():
            if _motionless(accusation):
                self._take_back(index, leg, suspicion.step, "is overloaded, not failed")
        if _motionless(suspicion):
            self._monitor.believe_whole(suspicion.leg, self._row(index))
            self._tell(f"noticed: leg {suspicion.leg} is overloaded, not failed")
            return True
        return False

    def _report_weak(self, step: int) -> None:
        """Report joints with part of their torque; no response made a walk with one better."""
        for index, noticed in enumerate(self.noticed):
            for suspicion in self._monitor.weak_joints(step, self._row(index)):
                noticed.append(Noticed(suspicion=suspicion, response=Response()))
                self._tell(f"noticed: {suspicion}, by {suspicion.evidence}")

    def _end_trials(self, index: int, suspicion: Suspicion) -> list[Suspicion]:
        """End the trials of other legs, as missing again: their load is learned again."""
        self._trials.pop((index, suspicion.leg), None)
        ended = [leg for each, leg in self._trials if each == index]
        again = []
        for leg in ended:
            until_step, failure = self._trials.pop((index, leg))
            if suspicion.step < until_step:
                self._failures[index].append(failure)
                self._first_tries[index, leg] /= AFTER_RELAPSE  # the trial was not conclusive
                self._monitor.believe_failed(leg, self._row(index))
                again.append(Suspicion(failure=failure, step=suspicion.step, evidence="support", ratio=0.0))
                self._tell(f"noticed: the trial of leg {leg} is over")
        return again

    def _settle_later(self, index: int, place: int, cycles: float) -> None:
        due = self.noticed[index][place].suspicion.step + round(cycles * self._cycle_steps(index))
        self._unsettled.append((due, index, place, cycles))

    def _try_later(self, index: int, suspicion: Suspicion) -> None:
        key = index, suspicion.leg
        self._probes[key] = LegProbe(
            suspicion.step,
            self._cycle_steps(index),
            # Joints with echoed targets follow them, whatever the leg does.
            moves=suspicion.failure.kind not in ON_TRIAL,
            first_cycles=self._first_tries.get(key, FIRST_CYCLES),
        )

    def _glide(self, responses: Mapping[int, Response]) -> None:
        self._change_gaits({index: one.gait for index, one in responses.items() if one.gait is not None})
        for index, response in responses.items():
            self._posture_trials.pop(index, None)
            self._hurry(index, 1.0)
            if response.gait is not None and response.tries and self.hold == "line":
                start, plan = self._start, self._plans[index]
                speed_m_s = ideal_speed_m_s(start.robot, plan.gait, plan.motion(0.0))
                self._posture_trials[index] = PostureTrial(
                    (response.gait, *response.tries), self._cycle_steps(index), speed_m_s * start.period_s
                )

    def _change_gaits(self, wanted: Mapping[int, Gait]) -> None:
        if not isinstance(self.walk, VelocityWalk):
            return
        gaits = list(self.walk.gaits)
        changes: BoolArray = np.zeros(len(gaits), dtype=bool)
        for index, gait in wanted.items():
            if gait != gaits[index]:
                gaits[index], changes[index] = gait, True
        if changes.any():
            self.walk.glide_to(gaits, changes if self._start.batch_shape else None)

    def _try_postures(self, state: RobotState) -> None:
        wanted: dict[int, Gait] = {}
        for index, trial in self._posture_trials.items():
            gait = trial.update(self._progress_m(state, index))
            self._hurry(index, trial.haste)
            if (haste := trial.rise()) is not None:
                pace_hz = haste * trial.gait.pace_hz
                self._tell(f"recovery: slow on this posture; pace raised to {pace_hz:.2f} Hz")
            if gait is not None:
                wanted[index] = gait
                self._tell(f"recovery: slow; body height now {gait.posture.body_raise:+.3f} of the size")
        if wanted:
            self._monitor.gait_changes(self._each([index in wanted for index in range(len(self.noticed))]))
            self._change_gaits(wanted)

    def _hurry(self, index: int, haste: float) -> None:
        if isinstance(self.walk, VelocityWalk):
            if self.walk.haste is None:
                self.walk.haste = np.ones(self._start.batch_shape)
            self.walk.haste[self._row(index)] = haste
            self._monitor.hurry(self.walk.haste)

    def _progress_m(self, state: RobotState, index: int) -> float:
        """Measured position along the line of a walk; NaN if it is unknown."""
        position, frame = state.base_position_world, self._start.frame
        if position is None or frame is None:
            return math.nan
        heading_rad = float(np.broadcast_to(frame.heading_rad, len(self.noticed))[index])
        x_m, y_m = position[self._row(index)][:2].tolist()
        return float(math.cos(heading_rad) * x_m + math.sin(heading_rad) * y_m)

    def _try_legs(self, step: int, state: RobotState) -> None:
        if not isinstance(self.walk, VelocityWalk):
            return
        offsets_m = np.zeros((*self._start.batch_shape, N_LEGS, 3))
        for (index, leg), probe in list(self._probes.items()):
            row, joints = self._row(index), leg_slice(leg)
            if leg not in self.walk.gaits[index].posture.tucked_legs or self._monitor.silent(leg, row):
                continue
            offsets_m[(*row, leg - 1)] = probe.offset_m(step, self._start.robot.size_m)
            if probe.whole(step, self._sent_rad[row][joints], state.joint_positions_rad[row][joints]):
                self._take_back(index, leg, step)
        self.walk.foot_offsets_m = offsets_m

    def _take_back(self, index: int, leg: int, step: int, why: str = "follows again") -> None:
        del self._probes[index, leg]
        key = index, leg
        self._first_tries[key] = AFTER_RELAPSE * self._first_tries.get(key, FIRST_CYCLES)
        before = next(one for one in self._failures[index] if one.leg == leg)
        self._failures[index].remove(before)
        self._monitor.believe_whole(leg, self._row(index))
        response = self._answer(index, self._failures[index])
        suspicion = Suspicion(failure=before, step=step, evidence="following", ratio=0.0)
        self.noticed[index].append(Noticed(suspicion=suspicion, response=response, healed=True))
        on_trial = before.kind in ON_TRIAL
        if on_trial:
            self._trials[key] = step + TRIAL_CYCLES * self._cycle_steps(index), before
        again = "is put down again, on trial" if on_trial else why
        self._tell(f"noticed: leg {leg} {again}", *response.lines)
        self._glide({index: response})

    def _settle_kind(self, index: int, place: int, cycles: float) -> None:
        """Evaluate the kind of failure again, from data after the failure only."""
        noticed = self.noticed[index]
        before = noticed[place].suspicion
        if index in self._stopped or before.failure not in self._failures[index]:
            return
        last = cycles == LOCKED_AFTER_CYCLES
        failure = self._monitor.kind(before.leg, self._row(index), cycles=cycles, powered=last)
        if not last and failure.kind in ("stuck", "locked"):
            self._settle_later(index, place, LOCKED_AFTER_CYCLES)
        # In the air all legs carry nothing, and follow better the less they move.
        if before.evidence in SETTLED or failure in (
            before.failure,
            Failure(leg=before.leg, kind="missing"),
        ):
            return
        if last and failure.kind != "locked":
            return
        suspicion = replace(before, failure=failure)
        noticed[place] = replace(noticed[place], suspicion=suspicion)
        self._failures[index] = [failure if one is before.failure else one for one in self._failures[index]]
        if (index, before.leg) in self._probes and "missing" in (failure.kind, before.failure.kind):
            self._try_later(index, suspicion)
        self._tell(f"noticed: it is {suspicion}")
        self._reconsider(index, place)

    def _reconsider(self, index: int, place: int) -> None:
        if not isinstance(self.walk, VelocityWalk):
            return
        response = self._answer(index, self._failures[index])
        if response.gait in (None, self.walk.gaits[index]) and not response.stop:
            return
        noticed = self.noticed[index]
        noticed[place] = replace(noticed[place], response=response)
        self._tell(*response.lines)
        if response.stop:
            self._stopped[index] = self._trouble or str(noticed[place].suspicion)
            return
        self._monitor.gait_changes(self._each([each == index for each in range(len(self.noticed))]))
        self._glide({index: response})

    def _suited(self, gaits: list[Gait]) -> list[Gait]:
        suited = []
        self._posture_trials.clear()
        for index, gait in enumerate(gaits):
            self._hurry(index, 1.0)
            self._plans[index] = replace(self._plans[index], gait=gait)
            answer = self._answer(index, self._failures[index]) if self.noticed[index] else Response()
            suited.append(gait if answer.gait is None else answer.gait)
        self._monitor.gait_changes(self._each([True] * len(suited)))
        return suited

    def _answer(self, index: int, failures: list[Failure]) -> Response:
        """The recovery's response; a recovery that fails stops the walk softly, and is named."""
        plan, label = self._plans[index], label_of(type(self._recovery))
        try:
            response = self._recovery.respond(self._start.robot, plan, self._headings_rad[index], failures)
        except Exception as error:  # noqa: BLE001  whatever it is, the robot is still walking
            show_traceback(error)
            self._trouble = f"recovery {label}: {why(error)}"
            return Response(stop=True)
        if not isinstance(response, Response):
            self._trouble = f"recovery {label}: respond gave {response!r}; allowed: a Response"
            return Response(stop=True)
        return response


def _motionless(suspicion: Suspicion) -> bool:
    return suspicion.evidence == "following" and suspicion.failure.kind in ("stuck", "locked")


def _steady(walk: Controller) -> bool:
    """Whether a walk keeps the motion of its plan: only then the habit of a part of the cycle stays valid."""
    return isinstance(walk, (SteeredWalk, MotionWalk, Walk))


def recovering_walk(recovery: Recovery | None = None) -> Callable[[WalkStart], MonitoredWalk]:
    """Factory of walks that recover, for `run_trial`; recovery None glides to a gait for the intact legs."""
    decides = GlideToStableGait() if recovery is None else recovery
    check_type(decides, Recovery, "recovery", "a Recovery")

    def make(start: WalkStart) -> MonitoredWalk:
        hold = possible_hold(start.plans[0], start.frame)
        walk = MotionWalk(start) if hold == "none" else SteeredWalk(start, hold=hold)
        walk.leave_plain()  # each walk of a batch may change its gait at its own time
        return MonitoredWalk(start, walk, decides)

    return make


def watched_walk(recovery: Recovery) -> Callable[[WalkStart], MonitoredWalk]:
    """Factory of monitored walks; if the recovery changes no gait, equal to the plans' walks bit by bit."""
    if type(recovery) not in (WalkOn, StopWalking):
        return recovering_walk(recovery)
    return lambda start: MonitoredWalk(start, planned_walk(start), recovery)
