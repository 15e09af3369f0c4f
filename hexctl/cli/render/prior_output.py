"""Priors and repertoires in the terminal."""

from typing import Any


def prior_line(described: dict[str, Any]) -> str:
    """What a prior is for."""
    legs = ",".join(str(leg) for leg in described["legs"])
    return (
        f"{described['prior']}: {described['robot']}, legs {legs} {described['failure']}, self-rotation "
        f"{described['self_rotation']}, {described['duration_s']:g} s, {described['worlds']} worlds a leg"
        f"{_kind(described)}"
    )


def _kind(described: dict[str, Any]) -> str:
    """Hold and objectives of a prior, or that it has no stances."""
    if "scores" in described:
        return f", hold {described['hold']}: {', '.join(described['scores'])}"
    return "" if described["stances"] else ", without stances"


def repertoire_line(described: dict[str, Any]) -> str:
    """What a repertoire is for."""
    pairs = f", pairs {', '.join(described['pairs'])}" if described["pairs"] else ""
    directions = "straight ahead" if described["directions"] == 1 else f"{described['directions']} directions"
    others, situations = described["others"], described["situations"]
    share = f"all {situations}" if others == situations else f"{others} of {situations}"
    return (
        f"{described['repertoire']}: {described['robot']}, legs {', '.join(described['legs'])}{pairs}, "
        f"{directions}, {described['walks']} walks of each gait; another than the safest is best in {share} "
        "situations"
    )
