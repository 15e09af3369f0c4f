"""One recorded diagnosis at rest on any backend: `hexctl diagnose` as a library call."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

from hexctl.backends.robot_options import RecordedOptions
from hexctl.control.controllers import Stand
from hexctl.control.diagnosis.leg_findings import Diagnosis, diagnosis_of, reported_by_operator, unsafe_legs
from hexctl.control.diagnosis.standing_test import ALL_PROBES, LIFTS, Probe, StandingTest
from hexctl.control.log import TickLog
from hexctl.control.loop import run_controller
from hexctl.control.preparation import WalkStart, ticks_of
from hexctl.control.trial_result import TrialResult
from hexctl.errors import CommandRefusedError, EStopError, InputError, argument
from hexctl.options import check_names
from hexctl.robot.failure_grammar import option_of, read_failures_before
from hexctl.runs.run import Run, RunResult
from hexctl.runs.run_spec import RunSpec
from hexctl.waiting import StopRequested, never_stop

#: Time to reach the stance and to settle before the first probe.
SETTLE_S = 0.8

#: Called with a leg after its lift: whether it lifted, swung and stood again; None ends the questions.
AskOperator = Callable[[int], bool | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosisResult(RunResult):
    """Result of a diagnosis; its trial is the standing test, with the status `ok` if it is complete.

    Attributes:
        diagnosis: findings by leg.
    """

    diagnosis: Diagnosis


class DiagnosisRun(Run):
    """A run whose controller makes the standing test: connected and recorded like a walk.

    The failure of its spec is simulated, but unknown to the diagnosis.
    """

    def __init__(self, spec: RunSpec) -> None:
        """Check a spec, whose gait and motion are ignored; raises InputError or LimitError."""
        failures = read_failures_before(spec.failure, None, "a failure before the diagnosis, such as 5:limp")
        if failures and not spec.simulated:
            name, value = option_of(failures[0])
            raise InputError(
                f"{argument(name)}: got {value} with {argument('backend')} {spec.backend}; "
                "allowed: with sim, which simulates the failure"
            )
        duration_s = sum(probe.duration_s for probe in ALL_PROBES)
        plain = {"hold": "none", "self_rotation": "none", "duration_s": duration_s + 3.0, "gait": "demo"}
        plain_spec = replace(spec, **plain)  # type: ignore[arg-type]  # as the fields are
        super().__init__(plain_spec, controller=self._make_test)
        self.plan = replace(self.plan, failures=(), travel=0.0, settle_s=SETTLE_S)
        self._test: StandingTest | None = None
        self.diagnosis: Diagnosis | None = None

    @property
    def title(self) -> str:
        """Title of recordings and live views."""
        return f"{self.robot.name} diagnosis"

    @property
    def _what(self) -> str:
        return "diagnosis"

    def diagnose(
        self,
        *,
        ask: AskOperator | None = None,
        stop_requested: StopRequested = never_stop,
    ) -> DiagnosisResult:
        """Make the standing test and judge it; arguments as in `diagnose`.

        Raises RobotFaultError when the robot or its link fails.
        """
        done = self.walk(stop_requested=stop_requested)
        found = self._found()
        if found.source == "none" and ask is not None and done.trial.status == "ok":
            found = self._ask_operator(found, ask, stop_requested)
            done.outcome.update(found.to_dict())
        return DiagnosisResult(
            diagnosis=found, **{one.name: getattr(done, one.name) for one in fields(RunResult)}
        )

    def _make_test(self, start: WalkStart) -> StandingTest:
        self._test = StandingTest(
            start.robot, start.period_s, unsafe=lambda observed: unsafe_legs(observed, self.robot)
        )
        return self._test

    def _found(self) -> Diagnosis:
        if self.diagnosis is None:
            test = self._test or StandingTest(self.robot, 0.02)
            self.diagnosis = diagnosis_of(test.observed, self.robot)
        return self.diagnosis

    def _outcome(self, trial: TrialResult, log: TickLog, wall_s: float) -> dict[str, Any]:
        whole = super()._outcome(trial, log, wall_s)
        kept = ("status", "stopped", "duration_s", "ticks", "overruns", "refused_commands", "servo_link")
        where = ("realtime_factor", "backend", "robot", "world", "seed", "recording")
        return {**self._found().to_dict(), **{name: whole[name] for name in (*kept, *where)}}

    def _ask_operator(self, found: Diagnosis, ask: AskOperator, stop_requested: StopRequested) -> Diagnosis:
        moved: dict[int, bool] = {}
        for probe in sorted(LIFTS, key=lambda lift: lift.legs):
            if stop_requested() or not self._make_alone(probe):
                return found
            answer = ask(probe.legs[0])
            if answer is None:
                return found
            moved[probe.legs[0]] = answer
        self.diagnosis = reported_by_operator(found, moved)
        return self.diagnosis

    def _make_alone(self, probe: Probe) -> bool:
        """Make one probe, then rest; return False after a stop."""
        guard = self._guard
        assert guard is not None  # noqa: S101  it is connected
        try:
            run_controller(guard, Stand(self.robot, guard.accepted_rad(), ticks_of(guard, SETTLE_S / 2)))
            run_controller(guard, StandingTest(self.robot, guard.clock.period_s, probes=(probe,)))
        except (EStopError, CommandRefusedError):
            return False
        guard.pause_watchdog()
        return True


def diagnose(
    *,
    ask: AskOperator | None = None,
    stop_requested: StopRequested = never_stop,
    **where: Any,
) -> DiagnosisResult:
    """Find the failed leg of a standing robot: `diagnose(failure="5:limp:femur")`.

    Args:
        ask: called with each leg's number if no measurement shows the legs: whether it lifted, swung and
            stood again; None ends the questions.
        stop_requested: called every tick; True ends the test.
        where: fields of `RecordedOptions`, such as robot and backend. Simulated failures are unknown to the
            diagnosis.

    Raises InputError before anything moves, RobotFaultError for a robot or a link that fails.
    """
    check_names(diagnose, where, RecordedOptions)
    spec = RunSpec(**where)
    with DiagnosisRun(spec) as connected:
        return connected.diagnose(ask=ask, stop_requested=stop_requested)
