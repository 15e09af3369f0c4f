"""A leg fails in mid-walk: the robot that recovers beside the same robot without recovery, as a GIF."""

from pathlib import Path

from hexctl.demo.rescue import RECOVER, WALK_ON, caption_of, walk_and_fail
from hexctl.export.export import export

#: What is shown: from a moment before the failure on, which the recording has some 2 s later than the walk.
FROM_S, SHOWN_S = 6.3, 9.6

WIDTH_PX, FPS = 720, 12.5


def draw_rescue(folder: Path) -> Path:
    """Walk twice, and draw both walks side by side, each above the share of its speed that it keeps."""
    recordings, captions = [], []
    for policy in (WALK_ON, RECOVER):
        recordings.append(folder / f"{policy}.rrd")
        walk = walk_and_fail(policy, recordings[-1])
        captions.append(caption_of(walk, recovered=policy == RECOVER))
    return export(
        *recordings,
        output=folder / "rescue.gif",
        captions=tuple(captions),
        from_s=FROM_S,
        duration_s=SHOWN_S,
        width_px=WIDTH_PX,
        fps=FPS,
    )
