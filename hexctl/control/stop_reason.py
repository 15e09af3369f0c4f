"""What a guard's reasons to stop mean, in words for people.

The reason itself (`state`, `expired`, `fault: low battery`) is what programs compare, in results, statuses
and on the wire; only messages carry the words.
"""

#: By the reason, or by what stands before its colon.
MEANINGS = {
    "state": "what the robot measures came too late or was not a number",
    "expired": "no command came in time",
    "pose lost": "its position or orientation, known before, stayed away",
    "fell": "its body leant too far",
    "estop": "a stop was asked for",
    "hot": "a servo is too hot",
}


def reason_in_words(reason: str) -> str:
    """A reason to stop with its meaning: `state (what the robot measures came too late ...)`.

    A reason of others, and one that says by itself what happened, stays as it is.
    """
    meaning = MEANINGS.get(reason.partition(":")[0])
    return reason if meaning is None else f"{reason} ({meaning})"
