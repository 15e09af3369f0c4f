"""A controller's end of a lease: takes it, keeps it alive, notices when it is gone."""

import os
import socket
import threading
import time
from typing import Any

import zenoh

from hexctl.backends.zenoh.asking import ask, ask_until
from hexctl.errors import RobotFaultError

#: How long a robot may take to give a lease.
ACQUIRE_PATIENCE_S = 2.0


def owner_name() -> str:
    """Return what this process calls itself to others who want the robot."""
    return f"hexctl on {socket.gethostname()} (process {os.getpid()})"


class Tenancy:
    """Holds the lease of a robot from `acquire` to `release`, renewing it at a third of its time.

    Attributes:
        lease_id: what commands carry.
        sequence: number of the lease.
        lost: why the lease is gone, or None while it is in force.
        lost_at_s: since when, on time.monotonic.
    """

    def __init__(self, session: zenoh.Session, key: str) -> None:
        self._session, self._key = session, key
        self.lease_id = b""
        self.sequence = 0
        self.lost: str | None = None
        self.lost_at_s = 0.0
        self._duration_s = 0.0
        self._over = threading.Event()
        self._keeper: threading.Thread | None = None

    def acquire(self) -> None:
        """Take the lease.

        Raises RobotFaultError that says who holds the robot, or why it gives none.
        """
        answer = self._ask_for_it()
        self.lease_id, self.sequence = bytes.fromhex(answer["lease"]), int(answer["sequence"])
        self._duration_s = float(answer["duration_s"])
        self._keeper = threading.Thread(target=self._keep, name="lease", daemon=True)
        self._keeper.start()

    def _ask_for_it(self) -> dict[str, Any]:
        """Return the robot's answer to a request for the lease; raises RobotFaultError for a refusal."""
        wanted = {"op": "acquire", "owner": owner_name()}
        until_s = time.monotonic() + ACQUIRE_PATIENCE_S
        while True:
            answers = ask_until(self._session, self._key, wanted, patience_s=ACQUIRE_PATIENCE_S)
            if not answers:
                raise RobotFaultError(
                    "the robot gives no lease: it does not answer, or this end may not command it"
                )
            refusal = answers[0].get("error")
            if refusal is None:
                return answers[0]
            # An answer that got lost on the way gave the lease to us, who do not know it; it ends by itself.
            if owner_name() not in str(refusal) or time.monotonic() > until_s:
                raise RobotFaultError(str(refusal))
            time.sleep(0.2)

    def rest(self) -> None:
        """Tell the robot that no command is due until the next one."""
        self._tell("rest")

    def release(self) -> None:
        """Give the lease back, if it is still in force."""
        self._over.set()
        if self._keeper is not None:
            self._keeper.join()
            if self.lost is None:
                self._tell("release")

    def _keep(self) -> None:
        """Renew until released; a robot that does not answer for the lease's whole time has gone."""
        heard_s = time.monotonic()
        while not self._over.wait(self._duration_s / 3) and self.lost is None:
            answer = self._tell("renew")
            if answer is not None:
                heard_s = self.lost_at_s = time.monotonic()
                self.lost = answer.get("error")
            elif time.monotonic() - heard_s > self._duration_s:
                self.lost_at_s = time.monotonic()
                self.lost = f"the robot has not answered for {time.monotonic() - heard_s:.1f} s"

    def _tell(self, op: str) -> dict[str, Any] | None:
        content = {"op": op, "lease": self.lease_id.hex()}
        try:
            answers = ask(self._session, self._key, content, patience_s=self._duration_s / 3)
        except zenoh.ZError:
            return None
        return answers[0] if answers else None
