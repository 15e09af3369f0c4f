"""The commands of `hexctl see`; without a command it locates a robot."""

from hexctl.cli.see.latency_command import latency
from hexctl.cli.see.print_command import print_
from hexctl.cli.see.see_calibrate_command import calibrate
from hexctl.cli.see.see_command import look
from hexctl.cli.settings import Commands, SettingsGroup

see = Commands(cls=SettingsGroup, no_args_is_help=True, invoke_without_command=True)
see.callback()(look)
see.command("print")(print_)
see.command()(calibrate)
see.command()(latency)
