"""Explanations of a guard's reasons to stop, for messages; programs compare the reason itself."""

#: By the reason, or by the text before its colon.
MEANINGS = {
    "state": "what the robot measures came too late, was not a number, or repeated itself",
    "expired": "no command came in time",
    "pose lost": "its position or orientation, known before, stayed away or repeated itself",
    "fell": "its body leant too far",
    "estop": "a stop was asked for",
    "hot": "a servo is too hot",
    "low battery": "charge it; the threshold is low_battery_v in the robot file",
}


def reason_in_words(reason: str) -> str:
    """A reason to stop with its explanation in brackets, if it has one."""
    meaning = MEANINGS.get(reason.partition(":")[0])
    return reason if meaning is None else f"{reason} ({meaning})"
