"""A walk that stops at an alarm, tests its legs while standing, and continues without the failed ones."""

from collections.abc import Sequence
from dataclasses import replace

from hexctl.control.controllers import Controller, Stand, soft_stop_steps
from hexctl.control.diagnosis.leg_findings import Diagnosis, diagnosis_of, unsafe_legs
from hexctl.control.diagnosis.standing_test import ALL_PROBES, Probe, StandingTest
from hexctl.control.monitor.monitored_walk import MonitoredWalk
from hexctl.control.monitor.recovery import Recovery, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import possible_hold
from hexctl.control.walks.velocity_walk import MotionWalk
from hexctl.robot.failure import MOST_FAILED, Failure, NoticedFailure, each_failure, failure_text, loses_leg
from hexctl.types import FloatArray, RobotState

#: Time from the end of the soft stop to rest in the stance, as before a separate diagnosis.
SETTLE_S = 0.8


class StopAndDiagnoseWalk(Controller):
    """Walks one robot until its monitor raises an alarm; stops, makes the standing test, and continues.

    The alarm only starts the test; the test finds leg and kind of failure. The walk then starts again,
    softly, on the original line, with the gait of the recovery for these failures. It stops again for another
    leg.

    Attributes:
        walk: the current one; after a stop it knows the failures that the standing tests have found.
    """

    def __init__(self, start: WalkStart, recovery: Recovery, *, probes: Sequence[Probe] = ALL_PROBES) -> None:
        self._start, self._recovery, self._probes = start, recovery, probes
        self._plan, self._heading_rad = start.plans[0], start.motions[0].heading_rad
        self.hold = possible_hold(self._plan, start.frame)
        recovery.prepare(start.robot, self._plan, self._heading_rad)
        self._failures: tuple[Failure, ...] = ()
        self._noticed: list[NoticedFailure] = []
        self._given_up: str | None = None
        self.walk = self._watched_walk()
        self._controller: Controller = self.walk
        self._first_step = self._stopped_at = self._limited_before = 0
        self._stopping = False
        self._sent_rad = start.robot.stance_angles_rad

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (18,)."""
        self._go_on(step, state)
        self._sent_rad = self._controller.targets_rad(step - self._first_step, state)
        if self._controller is self.walk and not self._stopping and self._alarmed():
            self._stopping = True
            self._stopped_at = step
            self.walk.stop(step - self._first_step)
        self.limited_steps = self._limited_before + int(self.walk.limited_steps)
        return self._sent_rad

    def done(self, step: int, state: RobotState) -> bool:
        """Whether its recovery has ended it."""
        return self._given_up is not None

    def why_stopped(self, index: int = 0) -> str | None:
        """The failures for which its recovery has ended it; None if it has not."""
        return self._given_up

    def noticed_failures(self, index: int = 0) -> tuple[NoticedFailure, ...]:
        """Failures that its standing tests have found."""
        return tuple(self._noticed)

    def _go_on(self, step: int, state: RobotState) -> None:
        now = self._controller
        if now is self.walk:
            if self._stopping and step >= self._stopped_at + soft_stop_steps(self._start.period_s):
                steps = round(SETTLE_S / self._start.period_s)
                self._lead(step, Stand(self._start.robot, self._sent_rad, steps // 2, steps - steps // 2))
        elif now.done(step - 1 - self._first_step, state):
            if isinstance(now, StandingTest):
                self._judge(step, diagnosis_of(now.observed, self._start.robot))
                self._limited_before += int(self.walk.limited_steps)
                self.walk, self._stopping = self._watched_walk(), False
                self._lead(step, self.walk)
            else:
                self._lead(step, self._standing_test())

    def _lead(self, step: int, controller: Controller) -> None:
        self._controller, self._first_step = controller, step

    def _alarmed(self) -> bool:
        known = {failure.leg for failure in self._failures}
        alarms = (one.suspicion.failure for one in self.walk.noticed[0])
        return any(one.leg not in known and loses_leg(one.kind) for one in alarms)

    def _standing_test(self) -> StandingTest:
        robot = self._start.robot
        return StandingTest(
            robot,
            self._start.period_s,
            probes=self._probes,
            unsafe=lambda observed: unsafe_legs(observed, robot),
        )

    def _judge(self, step: int, found: Diagnosis) -> None:
        before = {failure.leg for failure in self._failures}
        self._failures = found.failures
        for failure in found.failures:
            if failure.leg in before:
                continue
            self._noticed.append(
                NoticedFailure(
                    at_s=step * self._start.period_s,
                    failure=failure,
                    evidence="standing test",
                    did="stopped, diagnosed and walked on",
                )
            )

    def _watched_walk(self) -> MonitoredWalk:
        """A walk from standing, on the original line, with the gait for the remaining legs."""
        plan = self._plan
        if self._failures:
            found = self._recovery.respond(self._start.robot, plan, self._heading_rad, self._failures)
            plan = plan if found.gait is None else replace(plan, gait=found.gait)
            if found.stop:
                self._given_up = ", ".join(map(failure_text, self._failures))
        start = replace(self._start, plans=(plan,))
        walk = MotionWalk(start) if self.hold == "none" else SteeredWalk(start, hold=self.hold)
        walk.leave_plain()
        return MonitoredWalk(replace(start, plans=(self._plan_with_failures(plan),)), walk, WalkOn())

    def _plan_with_failures(self, plan: TrialPlan) -> TrialPlan:
        """Plan that includes the found failures, so the monitor does not watch those legs."""
        by_leg = {one.leg: one for one in (*plan.failures, *self._failures)}
        return replace(plan, failures=each_failure(tuple(by_leg.values()))[:MOST_FAILED])
