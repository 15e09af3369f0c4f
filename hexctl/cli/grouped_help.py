"""Options of a command in groups, where it has many."""

from typing import Any

#: A command with more options than this shows them in groups.
MOST_UNGROUPED = 8

#: Group of options that have none: what is printed, and help.
LAST = "Output"


#: What stands for a value in the help, by what Typer writes.
METAVARS = {"<int>": "N", "<float>": "N", "<path>": "FILE"}


class GroupedHelp:
    """A command that shows its options in groups where there are many."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help text."""
        options = [one for one in self.get_params(ctx) if one.opts[0].startswith("--")]  # type: ignore[attr-defined]
        grouped = len(options) - 1 > MOST_UNGROUPED  # without --help
        for option in options:
            option.rich_help_panel = (option.rich_help_panel or LAST) if grouped else None
            if option.metavar is None:  # Typer would write <bool> and <list[str]>
                option.metavar = (
                    "" if option.is_flag else METAVARS.get(option.display_type_rich(ctx=ctx), "TEXT")
                )
        super().format_help(ctx, formatter)  # type: ignore[misc]
