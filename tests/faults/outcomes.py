"""Made-up outcomes of injected faults."""

from typing import Any

from faults.measurement import Outcome


def outcome(**given: Any) -> Outcome:
    """A walk without a fault, but for what is given."""
    values: dict[str, Any] = {"fault": "none", "backend": "zenoh", "phase": "walking", "repetition": 0}
    values |= {"rest_s": None, "told_s": 1.0, "step": 1.0, "fell": False, "goes_on": True}
    return Outcome(**values | given)
