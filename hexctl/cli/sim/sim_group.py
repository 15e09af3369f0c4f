"""The commands of `hexctl sim`."""

from hexctl.cli.settings import Commands
from hexctl.cli.sim.board_command import board
from hexctl.cli.sim.camera_command import camera
from hexctl.cli.sim.failure_commands import fail, heal

sim = Commands(
    help="Simulate servo boards, servo buses and a camera, and let simulated legs fail.",
    no_args_is_help=True,
)
sim.command()(board)
sim.command()(camera)
sim.command()(fail)
sim.command()(heal)
