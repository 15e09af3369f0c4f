"""Robots on a link as a client sees them: their status, and a stop for all of them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from hexctl.backends.zenoh.zenoh_client import ask, ask_until, owner_name
from hexctl.client.clear_keys import forget, keys_for
from hexctl.errors import RobotFaultError
from hexctl.robot.failure_grammar import parse_failure_now, parse_leg
from hexctl.wire.description import RobotIdentity, check_may_command, robot_name, status_of
from hexctl.wire.links import ANY_ROBOT, Link, Role
from hexctl.wire.stop import LOCKOUT_S, MOST_CLAIMS, MOST_OTHERS_LOCKOUT_S, MOST_UNCLAIMED_LOCKOUT_S
from hexctl.wire.zenoh_session import open_session

ANSWER_TIMEOUT_S = 5.0


class RemoteRobots:
    """All robots on a link: usually one, whatever its name."""

    def __init__(self, session: zenoh.Session, link: Link) -> None:
        self._session, self.link = session, link
        self._keys = link.keys(ANY_ROBOT)

    def statuses(self) -> list[dict[str, Any]]:
        """Status of each robot that answers (docs/reference/zenoh.md), possibly none."""
        answers = ask(self._session, self._keys.describe, timeout_s=ANSWER_TIMEOUT_S)
        return [status_of(answer) for answer in answers]

    def await_statuses(self) -> list[dict[str, Any]]:
        """Status of each robot, even while it starts; raises RobotFaultError without any."""
        return [status_of(answer) for answer in self._ask(self._keys.describe)]

    def stop(self, request: str) -> list[dict[str, Any]]:
        """Stop every robot; `stopped` of each answer is its reason.

        The request is one stop, however often it is repeated, and claims it.
        Raises RobotFaultError unless at least one robot answers and all that answer have stopped.
        """
        answers = self._ask(self._keys.estop, {"op": "stop", "owner": owner_name(), "request": request})
        for answer in answers:
            if answer.get("stopped") is None:
                raise RobotFaultError(f"a robot did not stop: {answer.get('error', answer)}")
        return answers

    def clear(self, *, waiting: Callable[[str, float], None] | None = None) -> list[dict[str, Any]]:
        """Clear the current stop of each robot; `stopped` of each answer is None, or why it is stopped.

        Waits until the stop may be cleared: a second for this user's, minutes for others'. In each answer
        `cleared` is the stop in the form of the status, and `error` is the reason of a refusal.

        Args:
            waiting: called before a wait for another's stop, with its requester and the wait in s.

        Raises InputError for another user's robot on the default link, and RobotFaultError unless at least
        one robot answers and all that answer have cleared.
        """
        statuses = self.await_statuses()
        for status in statuses:
            check_may_command(RobotIdentity.of_answer(status), self.link)
        return [answer for status in statuses for answer in self._clear(status, waiting)]

    def _clear(
        self, status: dict[str, Any], waiting: Callable[[str, float], None] | None
    ) -> list[dict[str, Any]]:
        stop = status.get("stop")
        asked: dict[str, Any] = {"op": "clear", "owner": owner_name()}
        if isinstance(stop, dict):
            asked["id"] = str(stop.get("id"))
            asked["keys"] = _wait_to_clear(stop, waiting)
        key = self.link.keys(robot_name(status)).estop if "robot" in status else self._keys.estop
        answers = self._ask(key, asked)
        for answer in answers:
            if "stopped" not in answer:
                raise RobotFaultError(f"a robot did not clear its stop: {answer.get('error', answer)}")
        if isinstance(stop, dict) and all("error" not in answer for answer in answers):
            forget(_claims_of(stop))
        return [{**answer, "cleared": stop} for answer in answers]

    def fail(self, text: str) -> list[dict[str, Any]]:
        """Let a leg of every simulated robot fail, as in `5:limp`; `failures` of each answer lists all.

        Raises InputError for an invalid text, and for another user's robot on the default link;
        RobotFaultError if a robot refuses, as a real one does, or none answers.
        """
        parse_failure_now(text)
        return self._change({"op": "fail", "failure": text})

    def heal(self, leg: int) -> list[dict[str, Any]]:
        """Restore a leg of every simulated robot; raises what `fail` raises."""
        parse_leg(str(leg), "leg")
        return self._change({"op": "heal", "leg": leg})

    def _change(self, content: dict[str, Any]) -> list[dict[str, Any]]:
        for status in self.await_statuses():
            check_may_command(RobotIdentity.of_answer(status), self.link)
            if status.get("simulated") is None:
                raise RobotFaultError(
                    f"{RobotIdentity.of_answer(status)} is not simulated; no leg is changed"
                )
        answers = self._ask(self._keys.failure, content)
        for answer in answers:
            if "failures" not in answer:
                raise RobotFaultError(f"the robot refuses: {answer.get('error', answer)}")
        return answers

    def _ask(self, key: str, content: dict[str, Any] | None = None) -> list[dict[str, Any]]:
        silence = (
            f"no robot answers at {self.link.endpoint}; is hexctl serve running there, and may this end ask?"
        )
        return ask_until(self._session, key, content, timeout_s=ANSWER_TIMEOUT_S, silence=silence)


def _wait_to_clear(stop: dict[str, Any], waiting: Callable[[str, float], None] | None) -> list[str]:
    """Wait until a stop may be cleared; return the keys to present."""
    claims = _claims_of(stop)
    keys = keys_for(claims)
    if not claims or len(keys) == len(claims):
        time.sleep(_wait_s(stop.get("clear_in_s", 0.0), LOCKOUT_S if claims else MOST_UNCLAIMED_LOCKOUT_S))
        return keys
    wait_s = _wait_s(stop.get("others_in_s", 0.0), MOST_OTHERS_LOCKOUT_S)
    if wait_s > 0 and waiting is not None:
        waiting(str(stop.get("by") or "another client"), wait_s)
    time.sleep(wait_s)
    return keys


def _wait_s(reported_s: object, most_s: float) -> float:
    """The value from the network may be anything."""
    return min(most_s, max(0.0, reported_s)) if isinstance(reported_s, float) else LOCKOUT_S


def _claims_of(stop: dict[str, Any]) -> list[Any]:
    claims = stop.get("claims")
    return claims[:MOST_CLAIMS] if isinstance(claims, list) else []


@contextmanager
def remote_robots(link: Link, role: Role) -> Iterator[RemoteRobots]:
    """Robots on a link, for viewers or controllers, until the block ends.

    Raises InputError for an invalid link, RobotFaultError when nothing listens there.
    """
    with open_session(link, role, link.keys(ANY_ROBOT)) as session:
        yield RemoteRobots(session, link)
