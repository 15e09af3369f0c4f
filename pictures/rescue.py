"""A leg fails in mid-walk: the robot that recovers races the same robot without recovery, as a GIF."""

from pathlib import Path

from hexctl.demo.rescue import PICTURE, RECOVER, WALK_ON, walk_and_fail
from hexctl.export.export import export

#: The picture of the demo, with more pictures a second.
RACE = PICTURE | {"fps": 16.0}


def draw_rescue(folder: Path) -> Path:
    """Walk twice in the world of the demo, and draw both walks as a race."""
    recordings = [folder / f"{recovery}.rrd" for recovery in (WALK_ON, RECOVER)]
    for recovery, recording in zip((WALK_ON, RECOVER), recordings, strict=True):
        walk_and_fail(recovery, recording)
    return export(*recordings, output=folder / "rescue.gif", **RACE)
