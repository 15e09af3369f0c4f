"""Joint angles as the rotations that move the links, built in Arrow's layout.

Rerun's own converter walks over rotations one by one. Each link turns about an axis that never changes, so
its rotation is one number per tick, and that is also what makes the file small.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.record.block import KEPT_BITS, rounded
from hexctl.record.sdk import load_rerun
from hexctl.types import JOINT_KINDS, FloatArray

#: A positive coxa turns counter-clockwise from above; a positive femur or tibia lifts what points along x.
AXES = {"coxa": (0.0, 0.0, 1.0), "femur": (0.0, -1.0, 0.0), "tibia": (0.0, -1.0, 0.0)}


#: Binary places that a drawn angle is rounded to: a fiftieth of a degree.
DRAWN_BITS = 11


@dataclass(frozen=True, slots=True)
class ArrowBatch:
    """Component values in Arrow's layout."""

    array: Any

    def as_arrow_array(self) -> Any:
        """Return the values."""
        return self.array


class LinkColumns:
    """Makes the columns of links for a number of ticks; what all legs share is made once.

    Where a link begins on the one before never changes, and is not in here.
    """

    def __init__(self, ticks: int) -> None:
        self._offsets = np.arange(ticks + 1, dtype=np.int32)
        self._axes = {kind: _vectors(AXES[kind], ticks) for kind in JOINT_KINDS}

    def columns(self, kind: str, angles_rad: FloatArray) -> list[Any]:
        """Return the columns of a link of this kind: it turns through the measured angle.

        Args:
            kind: one of `JOINT_KINDS`.
            angles_rad: commanded and measured, (ticks, 2).
        """
        import pyarrow as pa

        axis = self._axes[kind]
        angle = pa.array(rounded(angles_rad[:, 1], DRAWN_BITS).astype(np.float32))
        fields = [
            pa.field("axis", axis.type, nullable=False),
            pa.field("angle", pa.float32(), nullable=False),
        ]
        turn = pa.StructArray.from_arrays([axis, angle], fields=fields)
        both = pa.array(rounded(angles_rad, KEPT_BITS).ravel())
        rr = load_rerun()
        return [
            self._column(rr.Transform3D.descriptor_rotation_axis_angle(), turn, self._offsets),
            self._column(rr.Scalars.descriptor_scalars(), both, 2 * self._offsets),
        ]

    def _column(self, descriptor: Any, values: Any, offsets: NDArray[np.int32]) -> Any:
        return load_rerun().ComponentColumn(descriptor, ArrowBatch(values), offsets=offsets)


def _vectors(vector: tuple[float, ...], ticks: int) -> Any:
    """Return the same 3-vector for each tick, as Arrow wants it."""
    import pyarrow as pa

    values = pa.array(np.tile(np.asarray(vector, dtype=np.float32), ticks))
    item = pa.field("item", pa.float32(), nullable=False)
    return pa.FixedSizeListArray.from_arrays(values, type=pa.list_(item, len(vector)))
