"""A session: the spec of one adaptation, and its trials."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES, Objective, undominated
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.optimizers.trim import mean_trim_rad, mean_turn_trim_rad_s
from hexctl.adapt.sessions.recommendation import recommended
from hexctl.control.trial_result import QUALITIES, TrialResult
from hexctl.gait.gait import AUTO
from hexctl.recording.sessions.session_overview import METRES, mark_text, score_text
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind

#: The policy of sessions whose trials watch no legs.
UNWATCHED = "walk-on"

#: Scores in m; reports name the first trial within each.
MILESTONES_M = (0.10, 0.025)


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSpec:
    """Everything that decides the course of a session; plain values, stored with it.

    Attributes:
        robot: name or path of the robot file.
        robot_fingerprint: of the description that the file held when the session began.
        backend: as in `hexctl run`.
        world: name or path of the world file; None on a real robot.
        failed_leg: the leg that failed.
        failure: its failure, as `hexctl.robot.failure_grammar.parse_kind` reads it.
        optimizer: name of the optimizer.
        objective: one of `hexctl.adapt.objectives.OBJECTIVES`, or `package.module:name`.
        objective_label: what an objective of your own measures; empty for those of hexctl.
        objective_unit: of the score.
        budget: trials that may be walked.
        target_m: a score at which to stop early, or None.
        target_share: the target as it was asked for, as a share of the ideal distance, or None.
        worth_m: expected gain of the trials left below which `bayes` ends the search; None to spend all, but
            for steered walks 1 % of the score.
        uncertainty_m: the simulation's own standard uncertainty of where a walk ends across its line, counted
            when a gait is confirmed; 0 where it is not known, not counted, or the robot is real.
        uncertainty_caveat: how the walks by which it was measured differ from those of the session, in words;
            empty where they do not.
        confirmed_uncertainty_m: likewise of the walks at a finer time step that confirm the end of a gait; 0
            where it is not known, so that nothing is confirmed.
        hold: what the walks hold by feedback, one of `hexctl.control.trial_plan.HOLDS`.
        body_raise: how much higher the body stands than in the stance, as a fraction of the robot's size.
        noise_m: standard deviation between trials of one gait that `bayes` believes until repeats tell; None
            without `bayes`, and for steered walks.
        confirm: repeats of the best gait after the search, within the budget.
        count_repeats: True to walk and count a code again when the optimizer asks for it again (the paper's
            count), False to answer from memory.
        duration_s: how long each trial walks.
        heading_deg: direction of travel.
        self_rotation: where the failed leg points during the walk.
        seed: of the optimizer and of the simulation.
        prior: path of the prior that the optimizer believes, or None.
        prior_digest: of what the prior held when the session began.
        early_stop: True to end a walk once its outcome is known well enough.
        connect: where the robot is, as in `hexctl run`; None for the backend's default.
        credentials: folder with the certificates of its link, or None.
        insecure: True to let a link beyond this computer do without.
        link: name or path of a link file, or None.
        arena_m: radius around `home_m` in which a robot that stays between trials is kept, or None.
        cool_down_c: temperature in degrees Celsius below which all servos are before each trial, or None.
        home_m: middle of the arena, x and y in the world: where the robot stood when the session began, or
            what was asked for; None without an arena.
        ask: True where an operator places the robot before each trial and measures after it.
        baseline_gaits: named gaits that are walked before the first trial, to compare with.
        policy: what a trial does about another leg that it notices to have failed, as in `hexctl run`; with
            `walk-on` legs are not watched, else such a trial does not count and ends the search.
        sag_rad: static deflection of each joint in the stance before the first trial, 18 numbers,
            None for a joint that is not measured; None where the prior or the robot does not tell.
    """

    robot: str = "ant"
    robot_fingerprint: str = ""
    backend: str = "sim"
    world: str | None = "flat"
    failed_leg: int = 5
    failure: str = "locked"
    optimizer: str = "random"
    objective: str = "final"
    objective_label: str = ""
    objective_unit: str = "m"
    budget: int = 20
    target_m: float | None = None
    confirm: int = 0
    count_repeats: bool = False
    duration_s: float = 30.0
    heading_deg: float = 0.0
    self_rotation: str = "rear"
    seed: int = 0
    prior: str | None = None
    prior_digest: str = ""
    early_stop: bool = False
    connect: str | None = None
    credentials: str | None = None
    insecure: bool = False
    link: str | None = None
    arena_m: float | None = None
    home_m: list[float] | None = None
    ask: bool = False
    sag_rad: list[float | None] | None = None
    baseline_gaits: list[str] = field(default_factory=list)
    target_share: float | None = None
    worth_m: float | None = None
    uncertainty_m: float = 0.0
    noise_m: float | None = None
    uncertainty_caveat: str = ""
    hold: str = "none"
    body_raise: float = 0.0
    policy: str = UNWATCHED
    cool_down_c: float | None = None
    confirmed_uncertainty_m: float = 0.0

    @property
    def simulated(self) -> bool:
        """Whether each trial has a simulation of its own, and so begins at the same place."""
        return self.backend == "sim"

    @property
    def broken(self) -> Failure:
        """The failure of the robot; its controller is told of it."""
        return parse_kind(self.failed_leg, self.failure)

    @property
    def score_label(self) -> str:
        """What the score is, in words."""
        known = OBJECTIVES.get(self.objective)
        return known.label if known is not None else self.objective_label or self.objective

    @property
    def target_text(self) -> str | None:
        """The target, for a person; both figures for a share of the distance. None without a target."""
        if self.target_m is None:
            return None
        unit = self.objective_unit
        rounded = float(f"{self.target_m:.3g}")
        text = mark_text(rounded) if unit == METRES else f"{rounded:g} {unit}".rstrip()
        if self.target_share is None:
            return text
        share = self.target_share
        return f"{text} ({100 * share:g} % of {self.target_m / share:.2f} {unit})"

    @property
    def greatest_chance(self) -> float | None:
        """Probability that a gait which ends on the line is within the target, by `uncertainty_m` alone.

        No gait can be confirmed with a greater one. None without a target or an uncertainty.
        """
        if self.target_m is None or not self.uncertainty_text:
            return None
        return math.erf(self.target_m / (math.sqrt(2) * self.uncertainty_m))

    def score_text(self, score: float) -> str:
        """Score with its unit, for a person; a length in cm."""
        return score_text(score, self.objective_unit)

    @property
    def uncertainty_text(self) -> str:
        """The simulation's own uncertainty of a score; empty if unknown, or if the score is no end."""
        uncertain = self.uncertainty_m > 0 and self.objective == "final"
        return score_text(self.uncertainty_m, METRES) if uncertain else ""

    def as_json(self) -> dict[str, Any]:
        """The spec as JSON values."""
        return asdict(self)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class WalkRecord:
    """A walk of a session, as it is stored.

    Attributes:
        slots: of its gait.
        score: by the session's objective; `INVALID_SCORE` for an invalid walk.
        outcome: its result, as `TrialResult.to_dict` writes it; `result` reads it.
        path_m: progress and signed deviation along the walk, five points a second.
        recording: path of the recording, or None.
        wanted_trim_deg: trim with which it would have ended on its line; None where it did not hold its
            heading, or is not valid.
        wanted_turn_trim_deg_s: likewise the turn that a walk in open loop wants, where it was trimmed.
        margin_m: smallest static stability margin of its gait over a cycle; None where it is not known.
    """

    slots: tuple[int, ...]
    score: float
    outcome: dict[str, Any]
    path_m: list[list[float]]
    recording: str | None
    wanted_trim_deg: float | None = None
    wanted_turn_trim_deg_s: float | None = None
    margin_m: float | None = None

    @property
    def result(self) -> TrialResult:
        """Result of the walk as it is stored: with five points of the path a second, and its end."""
        distance_m, signed_m = self.outcome["distance_m"], self.outcome["deviation_m"]["signed"]
        points = list(self.path_m)
        if distance_m is not None and signed_m is not None:
            points.append([distance_m, signed_m])
        return TrialResult.from_dict({**self.outcome, "path_m": points})

    @property
    def valid(self) -> bool:
        """Whether the walk counts."""
        return self.score < INVALID_SCORE

    def __repr__(self) -> str:
        return self._in_words()

    def _in_words(self, *names: str) -> str:
        """Names of the walk, its gait, and what came of it, on one line."""
        distance_m = self.outcome.get("distance_m")
        facts = [
            *names,
            f"slots {','.join(map(str, self.slots))}",
            str(self.outcome.get("status")),
            *([f"score {self.score:.4g}"] if self.valid else []),
            *([] if distance_m is None else [f"distance {distance_m:.3f} m"]),
        ]
        return f"{type(self).__name__}({', '.join(facts)})"

    def recording_in(self, folder: Path) -> Path | None:
        """Its recording in the folder of its session, there or not; None where it was not recorded.

        A store may have been moved since, or be another person's: of the stored path only the name counts.
        """
        return folder / Path(self.recording).name if self.recording else None

    def _measured_json(self) -> dict[str, Any]:
        """Outcome, in the order in which tables have it."""
        outcome = self.outcome
        return {
            "slots": list(self.slots),
            "score": self.score if self.valid else None,
            **{name: outcome[name] for name in ("deviation_m", "distance_m", "yaw_change_deg", "status")},
            **{name: outcome[name] for name in ("stopped", "clipped_ticks", "hold", *QUALITIES, "trim_deg")},
            "wanted_trim_deg": self.wanted_trim_deg,
            "turn_trim_deg_s": outcome["turn_trim_deg_s"],
            "wanted_turn_trim_deg_s": self.wanted_turn_trim_deg_s,
            "margin_m": None if self.margin_m is None else round(self.margin_m, 4),
        }


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class TrialRecord(WalkRecord):
    """One trial of a session, a `WalkRecord` with more.

    Attributes:
        index: 1 for the first trial.
        code: the gait tried.
        confirms: True for a repeat of the best gait.
        expected: what the optimizer expected of the trial, as `Prediction.as_json` says, or None.
    """

    index: int
    code: int
    confirms: bool = False
    expected: dict[str, Any] | None = None

    def __repr__(self) -> str:
        return self._in_words(f"trial {self.index}", f"code {self.code}")

    def as_json(self) -> dict[str, Any]:
        """The trial as `hexctl adapt --json` prints it."""
        return {
            "index": self.index,
            "code": self.code,
            **self._measured_json(),
            "confirms": self.confirms,
            "walked_s": self.outcome["duration_s"],
            "expected": self.expected,
            "recording": self.recording,
            "cause": self.outcome["cause"],
        }


#: Gaits that a robot would walk with anyway: the one that stands safest with the leg failed, its default one,
#: and the tripod.
BASELINE_GAITS = (AUTO, "demo", "tripod")

#: The index of a baseline: it comes before the first trial.
BASELINE_INDEX = 0


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class BaselineRecord(WalkRecord):
    """A `WalkRecord` of a gait that the robot would use anyway; no trial, and no optimizer is told of it.

    Attributes:
        gait: its name, such as `demo`.
        code: its code; None where it is not one of the session's gaits.
    """

    gait: str
    code: int | None

    def __repr__(self) -> str:
        return self._in_words(self.gait)

    def as_json(self) -> dict[str, Any]:
        """The walk as `hexctl adapt --json` prints it."""
        return {
            "gait": self.gait,
            "index": BASELINE_INDEX,
            "code": self.code,
            **self._measured_json(),
            "walked_s": self.outcome["duration_s"],
            "recording": self.recording,
            "cause": self.outcome["cause"],
        }


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ConfirmationRecord(WalkRecord):
    """A `WalkRecord` of a gait at a finer time step, in the same world; no trial.

    Attributes:
        code: of the gait; None where it is not one of the session's gaits.
        time_step_s: of the physics.
    """

    code: int | None
    time_step_s: float

    def as_json(self) -> dict[str, Any]:
        """The walk as `hexctl adapt --json` prints it."""
        return {"code": self.code, "time_step_s": self.time_step_s, **self._measured_json()}


def trials_text(count: int) -> str:
    """A number of trials: `1 trial`, `2 trials`."""
    return f"{count} trial" + ("" if count == 1 else "s")


@dataclass(slots=True, kw_only=True)
class Session:
    """A session as it stands: grows by a trial at a time.

    Attributes:
        name: unique in its store; also the name of its folder.
        spec: its options.
        trials: in the order in which they were walked.
        optimizer_state: the state after the last trial, or None before the first.
        created: when it began, ISO 8601.
        ended: why its search ended, as `AdaptLoop.run` returns it; None while it can be resumed.
        settled_on: the gait that the optimizer settles on and what it expects of it, as `Prediction.as_json`
            says, where it knows one.
        baseline: walks with the gaits that the robot would use anyway, before the first trial.
        confirmations: walks at a finer time step, after the search.
    """

    name: str
    spec: SessionSpec
    created: str
    trials: list[TrialRecord] = field(default_factory=list)
    optimizer_state: dict[str, Any] | None = None
    settled_on: dict[str, Any] | None = None
    ended: str | None = None
    baseline: list[BaselineRecord] = field(default_factory=list)
    confirmations: list[ConfirmationRecord] = field(default_factory=list)

    def confirmation_of(self, slots: Sequence[int]) -> ConfirmationRecord | None:
        """The walk of a gait at a finer time step, or None."""
        return next((walk for walk in self.confirmations if walk.slots == tuple(slots)), None)

    @property
    def walked_s(self) -> float:
        """Seconds walked in all trials."""
        return float(sum(trial.outcome["duration_s"] for trial in self.trials))

    @property
    def best(self) -> TrialRecord | None:
        """The valid trial with the lowest score, the earliest of equals; None without a valid trial."""
        valid = [trial for trial in self.trials if trial.valid]
        return min(valid, key=lambda trial: trial.score) if valid else None

    @property
    def best_walk(self) -> TrialRecord | BaselineRecord | None:
        """The walk that `recommended` names; if a trim was searched, None for a gait without a known one."""
        found = recommended(self)
        if found is None or self.spec.optimizer != TRIM:
            return None if found is None else found.walk
        trims = (self.trim_rad(found.walk.slots), self.turn_trim_rad_s(found.walk.slots))
        return found.walk if any(trim is not None for trim in trims) else None

    def trim_rad(self, slots: Sequence[int]) -> float | None:
        """Trim that is learned for a gait, the mean of what its walks want; None where none says.

        The baseline counts: an end that was measured is known, whatever it was walked for.
        """
        walks = self._walks_of(slots)
        wanted = [walk.wanted_trim_deg for walk in walks if walk.wanted_trim_deg is not None]
        return mean_trim_rad(map(math.radians, wanted)) if wanted else None

    def turn_trim_rad_s(self, slots: Sequence[int]) -> float | None:
        """Turn that is learned for a gait in open loop, likewise; None where no walk of it was trimmed."""
        walks = [
            (
                math.radians(walk.outcome["turn_trim_deg_s"]),
                math.radians(walk.wanted_turn_trim_deg_s),
                float(walk.outcome["duration_s"]),
            )
            for walk in self._walks_of(slots)
            if walk.wanted_turn_trim_deg_s is not None
        ]
        return mean_turn_trim_rad_s(walks) if walks else None

    def _walks_of(self, slots: Sequence[int]) -> list[WalkRecord]:
        return [walk for walk in (*self.baseline, *self.trials) if walk.slots == tuple(slots)]

    @property
    def best_trim_deg(self) -> float | None:
        """Trim that is learned for the gait of the best trial, in degrees; None without one."""
        trim_rad = None if self.best is None else self.trim_rad(self.best.slots)
        return None if trim_rad is None else math.degrees(trim_rad)

    @property
    def best_turn_trim_deg_s(self) -> float | None:
        """Turn that is learned for it in open loop, in degrees per second; None without one."""
        trim_rad_s = None if self.best is None else self.turn_trim_rad_s(self.best.slots)
        return None if trim_rad_s is None else math.degrees(trim_rad_s)

    def pareto(self, objectives: Sequence[Objective]) -> list[tuple[TrialRecord, list[float]]]:
        """Valid trials that no other valid one beats in all of some objectives, with their scores.

        Sorted by the first score; of equal trials all are there. Raises InputError where an objective needs
        what a trial did not measure.
        """
        valid = [trial for trial in self.trials if trial.valid]
        scores = np.array([[objective(trial.result) for objective in objectives] for trial in valid])
        front = [(valid[row], scores[row].tolist()) for row in np.flatnonzero(undominated(scores)).tolist()]
        return sorted(front, key=lambda pair: pair[1])

    def trials_to(self, milestone_m: float) -> int | None:
        """Index of the first trial whose score is within a milestone; None without one, or a score in m."""
        if self.spec.objective_unit != "m":
            return None
        return next((trial.index for trial in self.trials if trial.score <= milestone_m), None)

    @property
    def within_target(self) -> float | None:
        """Probability that the recommended gait, if confirmed, ends within the target; None if not."""
        found, target_m = recommended(self), self.spec.target_m
        if found is None or found.confirmation is None or target_m is None:
            return None
        reach_m = math.sqrt(2.0) * found.uncertainty_m
        below, above = (target_m - found.score) / reach_m, (target_m + found.score) / reach_m
        return 0.5 * (math.erf(below) + math.erf(above))

    def _recommended_json(self) -> dict[str, Any] | None:
        """The recommended walk and what is known of its end, as `hexctl adapt --json` prints it."""
        found, walk = recommended(self), self.best_walk
        if found is None or walk is None:
            return None
        return {
            "gait": walk.gait if isinstance(walk, BaselineRecord) else None,
            "code": walk.code,
            "slots": list(walk.slots),
            "score": found.score,
            "uncertainty_m": found.uncertainty_m or None,
            "confirmed": found.confirmation is not None,
            "within_target": self.within_target,
        }

    def as_json(self) -> dict[str, Any]:
        """The session as `hexctl adapt --json` prints it."""
        best = self.best
        return {
            "session": self.name,
            "created": self.created,
            **self.spec.as_json(),
            "baseline": [walk.as_json() for walk in self.baseline],
            "trials": [trial.as_json() for trial in self.trials],
            "best": None if best is None else best.as_json(),
            "best_trim_deg": self.best_trim_deg,
            "best_turn_trim_deg_s": self.best_turn_trim_deg_s,
            "found": best is not None,
            "walked_s": round(self.walked_s, 3),
            "settled_on": self.settled_on,
            "greatest_chance": self.spec.greatest_chance,
            "confirmations": [walk.as_json() for walk in self.confirmations],
            "recommended": self._recommended_json(),
            "ended": self.ended,
            **{
                f"trials_to_{milestone:.{digits}f}_m": self.trials_to(milestone)
                for milestone, digits in _DIGITS
            },
        }


_DIGITS = tuple(zip(MILESTONES_M, (2, 3), strict=True))
