"""Ask a robot something over Zenoh and wait for its answer."""

import time
from typing import Any

import zenoh

from hexctl.errors import MessageError
from hexctl.wire.describe import decode_json, encode_json

#: A robot answers within a tick; more than this is silence.
PATIENCE_S = 1.0


def ask(
    session: zenoh.Session, key: str, content: dict[str, Any] | None = None, *, patience_s: float = PATIENCE_S
) -> list[dict[str, Any]]:
    """Return what the robots at a key answer, a JSON object each; nobody may, then the list is empty.

    Args:
        session: an open one.
        key: one key, or a key expression.
        content: what to ask, or None.
        patience_s: how long to wait for answers.
    """
    payload = None if content is None else encode_json(content)
    answers = []
    for reply in session.get(key, payload=payload, timeout=patience_s):
        if reply.ok is not None:
            try:
                answers.append(decode_json(bytes(reply.ok.payload)))
            except MessageError:
                continue
    return answers


def ask_until(
    session: zenoh.Session, key: str, content: dict[str, Any] | None = None, *, patience_s: float
) -> list[dict[str, Any]]:
    """Ask again and again until somebody answers, for a while: a robot may just be coming up."""
    until_s = time.monotonic() + patience_s
    while True:
        answers = ask(session, key, content, patience_s=min(PATIENCE_S, patience_s))
        if answers or time.monotonic() > until_s:
            return answers
        time.sleep(0.05)
