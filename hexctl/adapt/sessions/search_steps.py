"""Steps of a session's search: its forecasts after each trial, and the reasons for the next gait.

Sessions do not store beliefs. Those of `bayes` are computed again from its prior and trials. Other optimizers
have none; custom optimizers are not imported to view a session, which may come from another person.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np

from hexctl.adapt.optimizer import NINETY_PERCENT
from hexctl.adapt.optimizers.bayes import Bayes, Choice
from hexctl.adapt.optimizers.shipped import BAYES, TRIM
from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.session_lines import DAMAGE
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.adapt.setting import load_setting
from hexctl.errors import HexctlError, InputError
from hexctl.recording.sessions.session_overview import GaitBeliefs, SearchStep, deviation_text

#: Maximum number of trials with beliefs: computing them takes 2 s and grows with the third power; `bayes`
#: rarely walks 20.
MOST_TRIALS = 60

#: What a search expects of all gaits after some trials, and its next choice.
Known = tuple[GaitBeliefs, Choice]


def search_steps(session: Session) -> tuple[SearchStep, ...]:
    """Steps from before the first trial to after the last one."""
    known: list[Known] = []
    missing = ""
    try:
        if (search := _search_of(session)) is not None:
            known = list(_replayed(session, search))
    except (HexctlError, OSError, *DAMAGE) as error:
        missing = f"what was expected of the gaits cannot be shown: {' '.join(str(error).split())}"
    else:
        if known:
            missing = f"what was expected of the gaits is shown until trial {MOST_TRIALS}"
    return tuple(
        _step(session, done, known[done] if done < len(known) else None, missing)
        for done in range(len(session.trials) + 1)
    )


def _search_of(session: Session) -> Bayes | None:
    """The search of a session as it began, or None; raises InputError if robot or prior have changed."""
    spec = session.spec
    if spec.optimizer != BAYES or spec.prior is None or spec.hold != "none":
        return None
    setting = load_setting(spec)
    search = make_search(spec, setting.robot, setting.plan, setting.prior)
    return search if isinstance(search, Bayes) else None


def _replayed(session: Session, search: Bayes) -> Iterator[Known]:
    """Knowledge after 0, 1, … `MOST_TRIALS` trials; raises InputError if the session has others."""
    state = session.optimizer_state or search.state()
    told = state["search"]["trials"]
    if [trial[0] for trial in told] != [trial.code for trial in session.trials]:
        raise InputError("steps: the optimizer was told of other trials than the session has")
    for done in range(min(len(told), MOST_TRIALS) + 1):
        search.restore({**state, "asked": None, "search": {**state["search"], "trials": told[:done]}})
        yield _known(search, session.spec.uncertainty_m)


def _known(search: Bayes, uncertainty_m: float) -> Known:
    """Current knowledge of a search; intervals include the simulation's uncertainty."""
    forecast = search.forecast()
    reach_m = NINETY_PERCENT * np.hypot(np.hypot(forecast.sd_m, forecast.noise_m), uncertainty_m)
    beliefs = GaitBeliefs(
        signed_m=forecast.mean_m, low_m=forecast.mean_m - reach_m, high_m=forecast.mean_m + reach_m
    )
    return beliefs, search.choice()


def _step(session: Session, done: int, known: Known | None, missing: str) -> SearchStep:
    following = session.trials[done] if done < len(session.trials) else None
    lines = [f"### {f'After {trials_text(done)}' if done else 'Before the first trial'}", ""]
    if done:
        lines += [f"- {_ended(session.trials[done - 1], session.spec.uncertainty_m)}"]
    lines += [f"- {_next(session, following, known)}"]
    if known is None and missing:
        lines += [f"- {missing}"]
    if session.baseline and session.spec.optimizer != TRIM:
        gaits = ", ".join(walk.gait for walk in session.baseline)
        lines += [f"- the search does not see the baseline walks: {gaits}"]
    return SearchStep(
        trials=done,
        note="\n".join(lines) + "\n",
        next_code=None if following is None else following.code,
        beliefs=None if known is None else known[0],
    )


def _ended(trial: TrialRecord, uncertainty_m: float) -> str:
    result = trial.result
    off = "at an unknown place" if result.deviation is None else deviation_text(result.deviation.signed)
    text = f"trial {trial.index}, gait {trial.code}: {result.status}, {off}"
    return text if trial.expected is None else f"{text}; expected {_expected(trial.expected, uncertainty_m)}"


def _next(session: Session, following: TrialRecord | None, known: Known | None) -> str:
    if following is None:
        return "the session goes on" if session.ended is None else f"the search ended: {session.ended}"
    text = f"**next: gait {following.code}**"
    if following.confirms:
        return f"{text}, a repeat of the best gait after the search"
    if known is not None and known[1].code == following.code:
        text += f", {known[1].why}"
    if following.expected is None:
        return text
    return f"{text}; expected {_expected(following.expected, session.spec.uncertainty_m)}"


def _expected(expected: dict[str, Any], uncertainty_m: float) -> str:
    """A stored prediction in words; its interval includes the simulation's own uncertainty."""
    middle_m = expected["signed_m"]
    reach_m = np.hypot(expected["high_m"] - middle_m, NINETY_PERCENT * uncertainty_m)
    ends = " to ".join(map(deviation_text, (middle_m - reach_m, middle_m + reach_m)))
    return f"{deviation_text(middle_m)}, 90 % interval {ends}"
