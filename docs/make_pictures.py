"""Make the README's picture: the `ant` in mid-walk with leg 5 failed, as the Rerun viewer draws it.

    .venv/bin/python docs/make_pictures.py OUT.png

Needs no screen but Xvfb and a software Vulkan driver (Debian: xvfb mesa-vulkan-drivers libvulkan1
libxkbcommon-x11-0 libxcursor1 libxi6 libxrandr2). The recording is made anew, and ends in mid-stride; the
picture's layout is the 3-D view alone, with the time cursor at the end.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "disable")

import rerun.blueprint as rrb
from PIL import Image

from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.plan import TrialPlan
from hexctl.control.trial import run_trial
from hexctl.gait.gait import Gait
from hexctl.gait.named import NAMED_SLOTS
from hexctl.record.blueprint import scene_view
from hexctl.record.paths import TIMELINE
from hexctl.record.recording import APPLICATION_ID, Recording
from hexctl.record.scene import LEVEL
from hexctl.record.viewer import LOCAL, viewer_binary
from hexctl.robot.failure import Failure
from hexctl.robot.file import load_robot

#: Size of the viewer's window and of the picture cut out of it, in points of two pixels.
WINDOW = (1240, 560)
PICTURE = (860, 420)

#: What is cut off above the picture: the window's frame and some sky, in points.
FRAME = 124

#: How long the robot of the picture has walked.
WALK_S = 9.35


def record_walk(path: Path) -> object:
    """Walk and stop in mid-stride, with a recording; return the picture's layout."""
    robot = load_robot("ant")
    defaults = robot.gait
    gait = Gait(
        slots=NAMED_SLOTS["demo"],
        pace_hz=defaults.pace_hz,
        amplitude=defaults.amplitude,
        height=defaults.height,
    )
    plan = TrialPlan(gait=gait, failure=Failure(leg=5), duration_s=WALK_S)
    servos = SimServos(robot, failure=plan.failure)
    with Recording(path, robot, plan, title="leg 5 failed") as recording, servos:
        log = TickLog(sink=recording.write_block)
        recording.finish(run_trial(Guard(servos), plan, log, soft_stop=False), {})
    return rrb.Blueprint(
        # The viewer's messages cover the right of its window: an empty view keeps them off the scene.
        rrb.Horizontal(
            scene_view(robot, plan, LEVEL), rrb.TextDocumentView(origin="none"), column_shares=[880, 360]
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="hidden", timeline=TIMELINE, play_state="following"),
        auto_views=False,
        auto_layout=False,
    )


@contextmanager
def virtual_screen() -> Iterator[str]:
    """Run an X server of our own on a free display, and yield the display's name."""
    program = shutil.which("Xvfb")
    if program is None:
        sys.exit("make_pictures: Xvfb is missing; on Debian: apt-get install xvfb mesa-vulkan-drivers")
    read_end, write_end = os.pipe()
    width, height = (2 * side for side in WINDOW)
    command = [program, "-displayfd", str(write_end), "-screen", "0", f"{width}x{height}x24"]
    server = subprocess.Popen([*command, "-nolisten", "tcp"], pass_fds=[write_end], stderr=subprocess.DEVNULL)
    os.close(write_end)
    try:
        with os.fdopen(read_end) as pipe:
            number = pipe.readline().strip()
        if not number:
            sys.exit("make_pictures: Xvfb did not start")
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


def take_picture(recording: Path, layout: Path, picture: Path) -> None:
    """Have the viewer draw a recording with a layout, and cut the picture out of its window."""
    size = "x".join(map(str, WINDOW))
    with virtual_screen() as display:
        command = [str(viewer_binary()), "--bind", LOCAL, "--port", "auto", "--window-size", size]
        subprocess.run(
            [*command, "--screenshot-to", str(picture), str(recording), str(layout)],
            check=True,
            env=os.environ | {"DISPLAY": display},
            stderr=subprocess.DEVNULL,
            timeout=120,
        )
    with Image.open(picture) as image:
        scale = image.width / WINDOW[0]
        box = (0, FRAME, PICTURE[0], FRAME + PICTURE[1])
        image.crop(tuple(round(scale * side) for side in box)).convert("RGB").save(picture, optimize=True)


def main() -> None:
    """Make the picture that the first argument names."""
    if len(sys.argv) != 2:
        sys.exit("usage: make_pictures.py OUT.png")
    subprocess.run([str(viewer_binary()), "analytics", "disable"], check=True, capture_output=True)
    with tempfile.TemporaryDirectory() as folder:
        recording, layout = Path(folder, "walk.rrd"), Path(folder, "picture.rbl")
        blueprint = record_walk(recording)
        blueprint.save(APPLICATION_ID, str(layout))
        take_picture(recording, layout, Path(sys.argv[1]))


if __name__ == "__main__":
    main()
