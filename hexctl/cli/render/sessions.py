"""Sessions as text next to one another: a table of all, and one that compares some."""

from collections.abc import Sequence

from rich.table import Table

from hexctl.adapt.loop import NOT_WORTH
from hexctl.adapt.sessions.comparison import best_so_far
from hexctl.adapt.sessions.session import Session
from hexctl.cli.render.adapt import in_cm, robot_name
from hexctl.cli.render.tables import plain_table

#: Why a search ended, in a word or two, if it is not the word that is stored.
ENDED = {"exhausted": "all tried", NOT_WORTH: "no gain left"}


def sessions_table(sessions: Sequence[Session]) -> Table:
    """Sessions, a row each: what was searched, how far it came, how it ended."""
    table = plain_table("session", "robot", "world", "failure", "trials", "best", "end")
    for column in table.columns[1:4] + table.columns[6:]:
        column.justify, column.no_wrap, column.overflow = "left", False, "fold"
    for session in sessions:
        spec = session.spec
        table.add_row(
            session.name,
            robot_name(spec.robot),
            spec.world or spec.backend,
            f"{spec.failed_leg} {spec.failure}",
            f"{len(session.trials)}/{spec.budget}",
            _best(session),
            "unfinished" if session.ended is None else ENDED.get(session.ended, session.ended),
        )
    return table


#: Numbers of trials that have a row of their own, besides the last one.
ROWS = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500, 1000)


def comparison_table(sessions: Sequence[Session]) -> Table:
    """Best score so far by the number of trials, a column for each session."""
    table = plain_table("trials", *(session.name for session in sessions))
    for column in table.columns[1:]:
        column.no_wrap, column.overflow = False, "fold"
    bests = [best_so_far(session) for session in sessions]
    last = max(len(best) for best in bests)
    for count in [*(count for count in ROWS if count < last), last]:
        cells = (
            "" if count > len(best) else _score(session, best[count - 1])
            for session, best in zip(sessions, bests, strict=True)
        )
        table.add_row(f"{count}", *cells)
    return table


def _best(session: Session) -> str:
    """Score of the best trial with its unit, or a dash."""
    return _score(session, None if session.best is None else session.best.score)


def _score(session: Session, score: float | None) -> str:
    """A score with its unit, or a dash."""
    if score is None:
        return "-"
    return in_cm(score) if session.spec.objective_unit == "m" else session.spec.score_text(score)
