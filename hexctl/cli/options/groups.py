"""Groups of options in the help of commands that have many: one name for one concept in all of them."""

from collections.abc import Mapping
from typing import Any

#: A command with more options than this shows them in groups.
MOST_UNGROUPED = 8

#: Options of each group.
GROUPS: Mapping[str, tuple[str, ...]] = {
    "Robot": ("backend", "robot", "world", "seed", "realtime", "ros2-control"),
    "Walk": (
        *("gait", "heading", "turn", "duration", "pace", "amplitude", "height", "body-raise"),
        *("stance-shift", "tuck", "swing-share", "then", "hold", "trim", "self-rotation"),
    ),
    "Failure": ("failed-leg", "failure", "heal", "recover", "policy", "legs"),
    "Search": (
        *("budget", "optimizer", "prior", "early-stop", "objective", "target", "worth", "confirm"),
        *("count-repeats", "no-baseline", "resume", "trust"),
    ),
    "On a robot": ("arena", "cool-down", "ask"),
    "Driving": ("keyboard", "gamepad", "page", "page-keys", "page-view"),
    "Checks": ("physics", "envelope", "leg-sets"),
    "Experiments": (
        *("transfer", "one-leg", "matrix", "holds", "recovery", "gaits", "methods", "protocols"),
        *("exact-sensors", "time-steps", "optimizers", "runs", "worlds", "repertoire", "directions"),
        *("codes", "pairs", "family"),
    ),
    "Camera": (
        *("camera", "place", "relearn", "lens", "fov-deg", "latency-ms", "size", "fps", "http-port"),
        *("position", "look-at"),
    ),
    "Sheet": (
        *("bar-mm", "robot-tag", "robot-edge-mm", "home-edge-mm", "floor-tags", "floor-edge-mm"),
        "tag-height-mm",
    ),
    "Flaws": ("noise", "blur", "drop", "shadow", "fault"),
    "Connection": (
        *(
            "connect",
            "listen",
            "device",
            "device-keys",
            "port",
            "pty",
            "expiry",
            "release-after",
            "sit-after",
        ),
        *("keys", "insecure", "link", "no-link"),
    ),
    "Servo bus": ("bus", "model", "baud"),
    "ROS": ("ros", "ros-domain", "ros-namespace", "ros-drive", "ros-humble"),
    "Recording": ("record", "no-record", "view"),
    "Computing": ("jobs", "dask"),
    "Output": ("to", "output", "out", "poses", "verbose", "quiet", "json", "help-all", "help"),
}

_GROUP_OF = {option: group for group, options in GROUPS.items() for option in options}

#: Where an option means something else, by command.
ELSEWHERE: Mapping[str, Mapping[str, str]] = {
    "study": {"hold": "Experiments"},
    "board": {"fault": "Servo bus"},
    "see": {"page": "Output"},
    "export": dict.fromkeys(("camera", "width", "fps", "from", "duration", "caption"), "Pictures"),
}


def group_of(command: str, option: str) -> str | None:
    """Group of an option in the help of a command, by their names; None for an option that has none."""
    return ELSEWHERE.get(command, {}).get(option, _GROUP_OF.get(option))


class GroupedHelp:
    """A command that shows its options in groups where there are many."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text."""
        options = [
            (param, flag[2:])
            for param in self.get_params(ctx)  # type: ignore[attr-defined]
            for flag in param.opts[:1]
            if flag.startswith("--")
        ]
        if len(options) - 1 > MOST_UNGROUPED:  # without --help
            for param, option in options:
                param.rich_help_panel = group_of(str(ctx.command.name), option)
            # Groups are shown in the order of their first option.
            self.params.sort(key=_place)  # type: ignore[attr-defined]
        super().format_help(ctx, formatter)  # type: ignore[misc]


def _place(param: Any) -> int:
    """Place of a parameter's group in the help; arguments come first."""
    group = str(getattr(param, "rich_help_panel", None))
    return list(GROUPS).index(group) if group in GROUPS else -1
