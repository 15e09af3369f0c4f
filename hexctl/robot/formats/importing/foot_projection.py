"""Feet next to the planes of their legs, which hexctl's kinematics does not have: legs turned to them."""

import math
from dataclasses import dataclass
from typing import Any

from hexctl.robot.formats.importing.import_values import rounded


@dataclass(frozen=True, slots=True)
class FootProjection:
    """Feet to the left of the planes of their legs, by leg; exact in a stance if all legs have one size of b.

    A foot at (r, b) of a leg, outward and left, is put at (r + c, 0) of the leg turned by atan2(b, r0), with
    r0 of the stance and r0 + c = hypot(r0, b).

    Attributes:
        offsets_m: b, with the sign of each leg.
        offset_m: size of b, the mean of the legs.
        coxa_end_m: of the file, (outward, up).
        yaws_rad: of the legs in the file.
    """

    offsets_m: tuple[float, ...]
    offset_m: float
    coxa_end_m: tuple[float, float]
    yaws_rad: tuple[float, ...]

    def outward_m(self, outward_m: float) -> float:
        """Distance of the foot from the coxa axis, of its distance in the plane of the leg."""
        return math.hypot(outward_m, self.offset_m)

    def sections(self, content: dict[str, Any], outward_m: float) -> dict[str, Any]:
        """The sections `mounts` and `links` of a robot file for a stance."""
        longer_m = self.outward_m(outward_m) - outward_m
        yaws_deg = [
            rounded(math.degrees(yaw_rad + math.atan2(offset_m, outward_m)))
            for yaw_rad, offset_m in zip(self.yaws_rad, self.offsets_m, strict=True)
        ]
        coxa = content["links"]["coxa"]
        end_m = [rounded(self.coxa_end_m[0] + longer_m), rounded(self.coxa_end_m[1])]
        return {
            "mounts": [
                mount | {"yaw_deg": yaw} for mount, yaw in zip(content["mounts"], yaws_deg, strict=True)
            ],
            "links": content["links"] | {"coxa": coxa | {"end_m": end_m}},
        }

    @property
    def note(self) -> str:
        """Note on the changed legs."""
        most_mm = 1000 * max(abs(offset_m) for offset_m in self.offsets_m)
        return (
            f"the feet are up to {most_mm:.1f} mm outside the planes of their legs: the legs were turned to "
            "them, and steps away from the stance are a little off"
        )
