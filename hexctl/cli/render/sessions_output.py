"""Tables of all sessions, and of a comparison."""

from collections.abc import Sequence

from rich.table import Table

from hexctl.adapt.sessions.comparison import best_so_far, scores_without_search
from hexctl.adapt.sessions.recommendation import recommended
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.walk_records import BaselineRecord
from hexctl.adapt.trial_loop import NOT_WORTH
from hexctl.cli.render.adapt_table import in_cm, robot_name
from hexctl.cli.render.tables import plain_table

#: Short texts of the ends of a search.
ENDED = {"exhausted": "all tried", NOT_WORTH: "no gain"}


def sessions_table(sessions: Sequence[Session]) -> Table:
    """Sessions, a row each, in 80 columns: subject, recommended gait, and end of the search."""
    table = plain_table("session", "robot", "world", "failure", "trials", "found", "end")
    table.padding = (0, 1, 0, 0)
    for column in table.columns[1:4]:
        column.no_wrap, column.overflow = False, "fold"
    for column in table.columns[1:4] + table.columns[5:]:
        column.justify = "left"
    for session in sessions:
        spec = session.spec
        table.add_row(
            session.name,
            robot_name(spec.robot),
            spec.world or spec.backend,
            str(spec.broken),
            f"{len(session.trials)}/{spec.budget}",
            _found(session),
            "unfinished" if session.ended is None else ENDED.get(session.ended, session.ended),
        )
    return table


#: Numbers of trials with a row, in addition to the last one.
ROWS = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500, 1000)


def comparison_table(sessions: Sequence[Session]) -> Table:
    """Scores of sessions, a column each: baseline, best by number of trials, result."""
    table = plain_table("trials", *(session.name for session in sessions))
    for column in table.columns[1:]:
        column.no_wrap, column.overflow = False, "fold"
    known = [scores_without_search(session) for session in sessions]
    for gait in dict.fromkeys(gait for scores in known for gait in scores):
        cells = (_score(session, scores.get(gait)) for session, scores in zip(sessions, known, strict=True))
        table.add_row(f"0: {gait}", *cells)
    bests = [best_so_far(session) for session in sessions]
    last = max(len(best) for best in bests)
    for count in [*(count for count in ROWS if count < last), last]:
        cells = (
            "-" if count > len(best) else _score(session, best[count - 1])
            for session, best in zip(sessions, bests, strict=True)
        )
        table.add_row(f"best of {count}", *cells)
    table.add_row("found", *map(_found, sessions))
    return table


def _found(session: Session) -> str:
    found = recommended(session)
    if found is None:
        return "-"
    walk = found.walk
    name = walk.gait if isinstance(walk, BaselineRecord) else f"{walk.code}"
    return f"{name} {_score(session, found.score)}"


def _score(session: Session, score: float | None) -> str:
    if score is None:
        return "-"
    return in_cm(score) if session.spec.objective_unit == "m" else session.spec.score_text(score)
