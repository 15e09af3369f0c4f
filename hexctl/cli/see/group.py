"""The commands of `hexctl see`; without a command it looks."""

from hexctl.cli.see.calibrate import calibrate
from hexctl.cli.see.latency import latency
from hexctl.cli.see.look import look
from hexctl.cli.see.sheet import print_
from hexctl.cli.see.twin import twin
from hexctl.cli.settings import Commands, SettingsGroup

see = Commands(cls=SettingsGroup, no_args_is_help=True, invoke_without_command=True)
see.callback()(look)
see.command("print")(print_)
see.command()(calibrate)
see.command()(latency)
see.command()(twin)
