"""Sessions beside one another as text: a table of all of them."""

from collections.abc import Sequence

from rich.table import Table

from hexctl.adapt.loop import NOT_WORTH
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


def _best(session: Session) -> str:
    """Score of the best trial with its unit, or a dash."""
    spec, best = session.spec, session.best
    if best is None:
        return "-"
    return in_cm(best.score) if spec.objective_unit == "m" else spec.score_text(best.score)
