"""Joint angles as the rotations that move the links, built in Arrow's layout.

Rerun's own converter walks over rotations one by one. Each link turns about an axis that never changes, so
its rotation is one number per tick, and that is also what makes the file small.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.record.sdk import load_rerun
from hexctl.robot.joints import JOINT_KINDS
from hexctl.robot.model import Robot

#: A positive coxa turns counter-clockwise from above; a positive femur or tibia lifts what points along x.
AXES = {"coxa": (0.0, 0.0, 1.0), "femur": (0.0, -1.0, 0.0), "tibia": (0.0, -1.0, 0.0)}


@dataclass(frozen=True, slots=True)
class ArrowBatch:
    """Component values in Arrow's layout."""

    array: Any

    def as_arrow_array(self) -> Any:
        """Return the values."""
        return self.array


class LinkColumns:
    """Makes the transform columns of links for a number of ticks; what all legs share is made once."""

    def __init__(self, robot: Robot, ticks: int) -> None:
        self._offsets = np.arange(ticks + 1, dtype=np.int32)
        self._axes = {kind: _vectors(AXES[kind], ticks) for kind in JOINT_KINDS}
        # Each joint sits at the end of the link before it; the coxa's is the mount itself.
        starts = [(0.0, 0.0), *robot.link_vectors_m[:-1]]
        self._starts = {
            kind: self._column("translation", _vectors((outward, 0.0, up), ticks))
            for kind, (outward, up) in zip(JOINT_KINDS, starts, strict=True)
        }

    def columns(self, kind: str, angles_rad: NDArray[np.float32]) -> list[Any]:
        """Return the columns of a link of this kind: it turns through the measured angle.

        Args:
            kind: one of `JOINT_KINDS`.
            angles_rad: commanded and measured, (ticks, 2).
        """
        import pyarrow as pa

        axis = self._axes[kind]
        angle = pa.array(np.ascontiguousarray(angles_rad[:, 1]))
        fields = [
            pa.field("axis", axis.type, nullable=False),
            pa.field("angle", pa.float32(), nullable=False),
        ]
        turn = pa.StructArray.from_arrays([axis, angle], fields=fields)
        # Rerun's scalars are doubles; the values stay those of single precision.
        both = pa.array(angles_rad.astype(np.float64).ravel())
        scalars = load_rerun().ComponentColumn(
            load_rerun().Scalars.descriptor_scalars(), ArrowBatch(both), offsets=2 * self._offsets
        )
        return [self._column("rotation_axis_angle", turn), self._starts[kind], scalars]

    def _column(self, name: str, values: Any) -> Any:
        rr = load_rerun()
        descriptor = getattr(rr.Transform3D, f"descriptor_{name}")()
        return rr.ComponentColumn(descriptor, ArrowBatch(values), offsets=self._offsets)


def _vectors(vector: tuple[float, ...], ticks: int) -> Any:
    """Return the same 3-vector for each tick, as Arrow wants it."""
    import pyarrow as pa

    values = pa.array(np.tile(np.asarray(vector, dtype=np.float32), ticks))
    item = pa.field("item", pa.float32(), nullable=False)
    return pa.FixedSizeListArray.from_arrays(values, type=pa.list_(item, len(vector)))
