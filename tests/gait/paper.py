"""The paper's Eq. 1 to 5 and its encoding, one leg and one moment at a time, in its own cases and letters."""

import math

from hexctl.gait.encoding import Slots

Vector = tuple[float, float, float]


def stroke(u: float, amplitude: float) -> float:
    """Offset m(u) in the plane, Eq. 3."""
    if u < 1 / 3:
        return 3 * u * amplitude / 2
    if u < 1 / 2:
        return amplitude / 2 - 3 * amplitude * (u - 1 / 3)
    if u < 2 / 3:
        return -3 * amplitude * (u - 1 / 2)
    return -amplitude / 2 * (1 - 3 * (u - 2 / 3))


def lift(u: float, height: float) -> float:
    """Height h(u), Eq. 4."""
    if u < 1 / 3:
        return 0.0
    if u < 1 / 2:
        return 6 * height * (u - 1 / 3)
    if u < 2 / 3:
        return height * (1 - 6 * (u - 1 / 2))
    return 0.0


def normalised_time(t: float, slot: int) -> float:
    """Normalised time u, Eq. 5."""
    return math.fmod(t + (slot - 1) / 6, 1.0)


def walking_feet(
    rest: list[Vector], slots: Slots, t: float, *, amplitude: float, height: float, theta: float
) -> list[Vector]:
    """Feet, Eq. 1 and 2; as printed, the stance feet move toward theta."""
    feet = []
    for (x, y, z), slot in zip(rest, slots, strict=True):
        u = normalised_time(t, slot)
        m = stroke(u, amplitude)
        feet.append((x + m * math.cos(theta), y + m * math.sin(theta), z + lift(u, height)))
    return feet


def numbered_gait(number: int, legs: int = 6) -> Slots:
    """Permutation g of a number in 1..n!, by the factorial number system: digit k counts (n - 1 - k)!."""
    rest, left = number - 1, list(range(1, legs + 1))
    g = []
    for k in range(legs):
        digit, rest = divmod(rest, math.factorial(legs - 1 - k))
        g.append(left.pop(digit))
    return tuple(g)


def numbered_recovery(number: int, failed: int) -> Slots:
    """Gait of the remaining five legs from a number in 1..5!; the failed leg keeps its own index."""
    others = [leg for leg in range(1, 7) if leg != failed]
    g = dict(zip(others, (others[index - 1] for index in numbered_gait(number, legs=5)), strict=True))
    return tuple({**g, failed: failed}[leg] for leg in range(1, 7))
