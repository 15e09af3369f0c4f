"""`hexctl gaits` and `hexctl worlds`: values of `--gait` and `--world`."""

import json

from hexctl.cli.console import print_result
from hexctl.cli.shared_options import JsonOption

#: Values of `--gait` that choose a gait for the robot.
CHOSEN = {
    "auto": "the most stable one for the robot, its failed legs and its direction",
    "best": "the best that a prior or a session knows for the failed leg",
}


def gaits(as_json: JsonOption = False) -> None:
    """List the named gaits."""
    from hexctl.cli.render.tables import label_table
    from hexctl.gait.gait import NAMED_SLOTS

    if as_json:
        print_result(json.dumps(NAMED_SLOTS))
        return
    rows = {
        name: f"legs 1 to 6 step in slots {','.join(map(str, slots))}" for name, slots in NAMED_SLOTS.items()
    }
    more = "--gait also takes a code, 1..720, or six slots such as 5,1,2,4,3,6"
    print_result(label_table((rows | CHOSEN).items()), "", more)


def worlds(as_json: JsonOption = False) -> None:
    """List the shipped simulated worlds."""
    from hexctl.cli.render.tables import label_table
    from hexctl.robot.configs import config_names, find_config, read_mapping

    texts = {}
    for name in config_names("worlds"):
        path = find_config("worlds", name)
        shown = f"{name}:NUMBER" if "ranges" in read_mapping(path) else name
        texts[shown] = _first_sentence(path.read_text(encoding="utf-8"))
    if as_json:
        print_result(json.dumps(texts))
        return
    print_result(
        label_table(texts.items()), "", "--world also takes a YAML file with the differences from flat"
    )


def _first_sentence(text: str) -> str:
    comment = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.removeprefix("#").strip())
    return " ".join(comment).partition(". ")[0].removesuffix(".") + "."
