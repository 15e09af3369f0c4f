"""The commands of hexctl, as its help lists them: light to import."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Command:
    """A command as the help lists it; its module is in a folder of `hexctl.cli`, or behind an entry point."""

    folder: str | None
    panel: str
    summary: str


#: Commands by group and in the order of the help: folder in `hexctl.cli` or None, and summary.
GROUPS: dict[str, dict[str, tuple[str | None, str]]] = {
    "Walk and adapt": {
        "run": ("walk", "Walk, record the walk, and report the result."),
        "adapt": ("walk", "Find a gait for a failed leg in few trials; each is kept and recorded."),
        "drive": ("walk", "Drive a robot by hand: keyboard, gamepad, or a page for a phone."),
        "play": ("walk", "Drive a simulated robot in the browser, and break its legs by a click."),
        "policy": ("walk", "Show, check and describe a trained policy before it walks."),
        "view": (
            "results",
            "Open recordings or sessions in the Rerun viewer until it is closed, or watch a robot.",
        ),
        "demo": ("walk", "Break a leg of a simulated robot in mid-walk, and see it recover."),
        "sessions": ("results", "List, compare and delete sessions of hexctl adapt."),
        "export": ("results", "Write a robot, recordings or a session in a format of other programs."),
    },
    "Your robot": {
        "check": (
            "robot",
            "Check whether a robot can walk a gait: reach, angles, speeds, torques and servo pulses.",
        ),
        "robot": ("robot", "List the shipped robots, and make robot files."),
        "gaits": ("robot", "List the named gaits."),
        "worlds": ("robot", "List the shipped simulated worlds."),
        "diagnose": ("walk", "Find which leg and joint failed, and how, in 12 s of small motions at rest."),
        "identify": (
            "robot",
            "Find stiffness, damping, rotor inertia, friction and dead time of a robot's servos.",
        ),
        "see": (
            None,
            "Measure a robot's position with a camera and printed tags, and send it to the robot, "
            "until Ctrl-C.",
        ),
        "calibrate": (
            "bus",
            "Find direction, offset and limits of each servo, and write them to the robot file.",
        ),
        "ports": ("bus", "List serial ports with a device, and their adapters."),
        "doctor": ("robot", "Report what this computer has and what works on it, for a bug report."),
        "servos": (
            "bus",
            "Scan, identify and set up the servos of a serial bus, with or without a robot file.",
        ),
        "sim": (None, "Simulate servo boards, servo buses and a camera, and let simulated legs fail."),
    },
    "Over the network": {
        "serve": (
            "network",
            "Serve a robot, real or simulated, on the network, with its own guard and stop.",
        ),
        "status": (
            "network",
            "Show who commands a robot on the network, why it is stopped, and which messages were dropped.",
        ),
        "estop": ("network", "Stop a robot on the network from anywhere, whichever client commands it."),
        "keys": ("network", "Make and show certificates for robots beyond this computer."),
    },
    "Simulate a lot": {
        "study": (
            None,
            "Repeat the paper's experiments: all gaits of each failed leg, all optimizers, one report.",
        ),
        "prior": (None, "Make and show priors: what hexctl adapt believes before its first trial."),
    },
}

COMMANDS = {
    name: Command(folder, panel, summary)
    for panel, commands in GROUPS.items()
    for name, (folder, summary) in commands.items()
}

#: Commands in the module of another one.
MODULES = {"gaits": "robot", "worlds": "robot"}
