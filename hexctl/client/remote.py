"""Robots on a link, seen from outside: their status, and a stop for all of them."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import zenoh

from hexctl.backends.zenoh.zenoh_client import ask, ask_until, owner_name
from hexctl.client.clear_keys import NewClaim, forget, keys_for
from hexctl.errors import RobotFaultError
from hexctl.robot.failure_grammar import parse_failure_now, parse_leg
from hexctl.wire.description import RobotIdentity, check_may_command, robot_name, status_of
from hexctl.wire.links import KeyMap, Link, Role, load_link
from hexctl.wire.stop import HOLD_S, MOST_CLAIMS, MOST_OTHERS_HOLD_S, MOST_UNCLAIMED_HOLD_S
from hexctl.wire.zenoh_session import open_session

#: Instead of a robot's name: every robot on the link.
ANY_ROBOT = "*"

#: How long a robot may take to answer.
ANSWER_TIMEOUT_S = 5.0


class RemoteRobots:
    """All robots on a link: usually one, whatever its name."""

    def __init__(self, session: zenoh.Session, link: Link) -> None:
        self._session, self._link = session, link
        self._keys = KeyMap.of(ANY_ROBOT).renamed(dict(link.names))

    @property
    def link(self) -> Link:
        """Link to the robots."""
        return self._link

    def statuses(self) -> list[dict[str, Any]]:
        """Status of each robot that answers (docs/protocol.md); empty where none does."""
        answers = ask(self._session, self._keys.describe, timeout_s=ANSWER_TIMEOUT_S)
        return [status_of(answer) for answer in answers]

    def await_statuses(self) -> list[dict[str, Any]]:
        """Status of each robot, waiting for one that is just coming up.

        Raises RobotFaultError when no robot answers.
        """
        return [status_of(answer) for answer in self._ask(self._keys.describe)]

    def stop(self, request: str | None = None) -> list[dict[str, Any]]:
        """Stop every robot, also those that others started; `stopped` of each answer is its reason.

        A request with a name is one stop, however often and by whatever way it comes. Without a name it is
        claimed, and this user can clear it quickly.

        Raises RobotFaultError unless each robot that answers has stopped, and one has answered.
        """
        if request is None:
            claimed = NewClaim()
            claimed.keep()
            request = claimed.claim
        answers = self._ask(self._keys.estop, {"op": "stop", "owner": owner_name(), "request": request})
        for answer in answers:
            if answer.get("stopped") is None:
                raise RobotFaultError(f"a robot did not stop: {answer.get('error', answer)}")
        return answers

    def clear(self, *, waiting: Callable[[str, float], None] | None = None) -> list[dict[str, Any]]:
        """Clear the stop that each robot has now; `stopped` of each answer is None, or why it is stopped.

        A stop is cleared once it may be: of this user after a second, of others after minutes. `cleared` of
        each answer is the stop that was meant, as the status has it, and `error` says why it was refused.

        Args:
            waiting: called before a wait for a stop of others, with who asked for it and the wait in s.

        Raises InputError for a robot of another user on a link that was not named, and RobotFaultError unless
        each robot that answers has done it, and one has answered.
        """
        statuses = self.await_statuses()
        for status in statuses:
            check_may_command(RobotIdentity.of_answer(status), self._link)
        return [answer for status in statuses for answer in self._clear(status, waiting)]

    def _clear(
        self, status: dict[str, Any], waiting: Callable[[str, float], None] | None
    ) -> list[dict[str, Any]]:
        """Clear the stop that a status tells of."""
        stop = status.get("stop")
        asked: dict[str, Any] = {"op": "clear", "owner": owner_name()}
        if isinstance(stop, dict):
            asked["id"] = str(stop.get("id"))
            asked["keys"] = _wait_to_clear(stop, waiting)
        key = self._link.keys(robot_name(status)).estop if "robot" in status else self._keys.estop
        answers = self._ask(key, asked)
        for answer in answers:
            if "stopped" not in answer:
                raise RobotFaultError(f"a robot did not clear its stop: {answer.get('error', answer)}")
        if isinstance(stop, dict) and all("error" not in answer for answer in answers):
            forget(_claims_of(stop))
        return [{**answer, "cleared": stop} for answer in answers]

    def fail(self, text: str) -> list[dict[str, Any]]:
        """Let a leg of every simulated robot fail, as `5:limp` says; `failures` of each answer has them all.

        Raises InputError for a text that is not allowed, and for a robot of another user on a link that was
        not named; RobotFaultError where a robot refuses, as a real one does, and where none answers.
        """
        parse_failure_now(text)
        return self._change({"op": "fail", "failure": text})

    def heal(self, leg: int) -> list[dict[str, Any]]:
        """Let a leg of every simulated robot be whole again; raises what `fail` raises."""
        parse_leg(str(leg), "leg")
        return self._change({"op": "heal", "leg": leg})

    def _change(self, content: dict[str, Any]) -> list[dict[str, Any]]:
        for status in self.await_statuses():
            check_may_command(RobotIdentity.of_answer(status), self._link)
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
        """Answers of all robots; raises RobotFaultError when there is none."""
        silence = (
            f"no robot answers at {self._link.endpoint}; is hexctl serve running there, and may this end ask?"
        )
        return ask_until(self._session, key, content, timeout_s=ANSWER_TIMEOUT_S, silence=silence)


def _wait_to_clear(stop: dict[str, Any], waiting: Callable[[str, float], None] | None) -> list[str]:
    """Wait until a stop of a status may be cleared; the keys to show."""
    claims = _claims_of(stop)
    keys = keys_for(claims)
    if not claims or len(keys) == len(claims):
        time.sleep(_wait_s(stop.get("clear_in_s", 0.0), HOLD_S if claims else MOST_UNCLAIMED_HOLD_S))
        return keys
    wait_s = _wait_s(stop.get("others_in_s", 0.0), MOST_OTHERS_HOLD_S)
    if wait_s > 0 and waiting is not None:
        waiting(str(stop.get("by") or "another client"), wait_s)
    time.sleep(wait_s)
    return keys


def _wait_s(told_s: object, most_s: float) -> float:
    """How long to wait, by what a robot said, which may be anything."""
    return min(most_s, max(0.0, told_s)) if isinstance(told_s, float) else HOLD_S


def _claims_of(stop: dict[str, Any]) -> list[Any]:
    claims = stop.get("claims")
    return claims[:MOST_CLAIMS] if isinstance(claims, list) else []


@contextmanager
def remote_robots(
    role: Role,
    *,
    connect: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
    link: str | None = None,
) -> Iterator[RemoteRobots]:
    """Robots on a link while the block runs.

    Args:
        role: a viewer asks for the status, a controller may stop too.
        connect: Zenoh endpoint; None is that of the link, or the default.
        credentials: folder of certificates, or None.
        insecure: whether a link beyond this computer may do without certificates.
        link: name or path of a link file, or None.

    Raises InputError for a link that is not allowed, RobotFaultError when nothing listens there.
    """
    settings = load_link(link, endpoint=connect, credentials=credentials, insecure=insecure)
    keys = KeyMap.of(ANY_ROBOT).renamed(dict(settings.names))
    with open_session(settings, role, keys) as session:
        yield RemoteRobots(session, settings)
