"""The paper's claims about the landscapes: where robots with a failed leg go."""

from collections.abc import Sequence

from hexctl.study.bars import EARLY_M, LATE_M
from hexctl.study.claim import Claim, per_leg
from hexctl.study.findings import Findings
from hexctl.study.landscape import Landscape

#: Share of the gaits that is a tendency to one side; both sides have at least a fifth.
TENDENCY, BOTH = 0.9, 0.2


def left_share(landscape: Landscape) -> float:
    """Return the share of the gaits that end on the left, of all that have an end; NaN where none has."""
    left, right = ends(landscape)
    return left / (left + right) if left + right else float("nan")


def ends(landscape: Landscape) -> tuple[int, int]:
    """Return how many gaits end on the left and on the right, valid or not."""
    signed = landscape.number("signed_m")
    return int((signed > 0).sum()), int((signed <= 0).sum())


def within(landscape: Landscape, limit_m: float) -> int:
    """Return how many valid gaits end within a distance of the line."""
    return int((landscape.final_m[landscape.valid] <= limit_m).sum())


def veers_left(findings: Findings) -> Claim:
    """Return what was found of the claim about legs 2 and 3."""
    return _side(findings, (2, 3), "left", "When leg 2 or 3 fails, the robot moves to the left", 1)


def veers_right(findings: Findings) -> Claim:
    """Return what was found of the claim about legs 5 and 6."""
    return _side(findings, (5, 6), "right", "When leg 5 or 6 fails, the robot moves to the right", -1)


def _side(findings: Findings, legs: Sequence[int], side: str, claim: str, sign: int) -> Claim:
    legs = [leg for leg in legs if leg in findings.plan.legs]
    shares = [left_share(findings.without(leg)) for leg in legs]
    shares = [share if sign > 0 else 1 - share for share in shares]
    return Claim(
        claim=claim,
        rule=f"at least {TENDENCY:.0%} of each leg's gaits end on the {side}, without self-rotation",
        measured=per_leg(legs, [f"{share:.0%} {side}" for share in shares]),
        beside="",
        holds=all(share >= TENDENCY for share in shares) if legs else None,
    )


def goes_both_ways(findings: Findings) -> Claim:
    """Return what was found of the claim about legs 1 and 4."""
    legs = [leg for leg in (1, 4) if leg in findings.plan.legs]
    shares = [left_share(findings.without(leg)) for leg in legs]
    return Claim(
        claim="When leg 1 or 4 fails, the robot goes straight or turns left or right, depending on the gait",
        rule=f"each side has at least {BOTH:.0%} of each leg's gaits, without self-rotation",
        measured=per_leg(legs, [f"{share:.0%} left, {1 - share:.0%} right" for share in shares]),
        beside="",
        holds=all(BOTH <= share <= 1 - BOTH for share in shares) if legs else None,
    )


def rotation_helps(findings: Findings) -> Claim:
    """Return what was found of the claim about the effect of the self-rotation."""
    legs = findings.plan.legs
    near = [within(findings.rotated(leg), EARLY_M) for leg in legs]
    before = [within(findings.without(leg), EARLY_M) for leg in legs]
    counts = [
        f"{count} ({within(findings.rotated(leg), LATE_M)} within 2.5 cm)"
        for leg, count in zip(legs, near, strict=True)
    ]
    return Claim(
        claim="After the self-rotation there are gaits with a small deviation, whichever leg failed",
        rule="each leg has a valid gait that ends within 10 cm of the line",
        measured="gaits within 10 cm: " + per_leg(legs, counts),
        beside="without self-rotation: " + per_leg(legs, [str(count) for count in before]),
        holds=all(count > 0 for count in near),
    )
