"""The arena: all methods of recovery in the same held-out worlds.

`python -m benchmarks.arena FILE [WORLDS] [FIRST]`: in each world of `transfer` and of `real` one leg fails in
mid-walk, another one and in another way in each. FILE gets the raw episodes as JSON lines; those that it has
are not walked again. The table is printed at the end.
"""

import json
import math
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.sim.world import load_randomization
from hexctl.learning.policy import policy_of
from hexctl.robot.loader import load_robot
from hexctl.study.held_out import FAILURES
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import METHODS
from hexctl.study.recovery.recovery_plan import FAMILIES, LINE, RecoveryPlan
from hexctl.study.recovery.trial_and_error import behaviours_of
from hexctl.study.study_options import ALL_LEGS

ROBOT = "ant"

WORLDS, FIRST_WORLD = 6, 9976

#: Columns of an episode that the table is made of.
COLUMNS = (
    "family",
    "world",
    "method",
    "legs",
    "failure",
    "heading_deg",
    "at_s",
    "status",
    "final_m",
    "way_m",
    "trials",
)


def cases(worlds: int, first_world: int) -> Iterator[tuple[RecoveryPlace, RecoveryCase]]:
    """One failure in each world, by each method."""
    for number in range(worlds):
        for family, name in enumerate(FAMILIES):
            plan = RecoveryPlan(
                robots=(load_robot(ROBOT),),
                families={name: load_randomization(name)},
                worlds=1,
                first_world=first_world + number,
                legs=(ALL_LEGS[number % len(ALL_LEGS)],),
                failures=(FAILURES[(number + family * worlds) % len(FAILURES)],),
                methods=tuple(METHODS),
                protocols=(LINE,),
            )
            ((place, walks),) = plan.walked()
            yield from ((place, case) for case in walks if case.legs)


def episode(place: RecoveryPlace, case: RecoveryCase) -> dict[str, Any]:
    """Row of an episode: what the robot did, and the time of one core that its trials and its walk took."""
    began_s = time.process_time()
    (walk,) = place.walk([case])
    row = place.row(walk)
    speed = walk.after_m_s / walk.ideal_m_s if walk.ended else 0.0
    kept = {name: row[name] for name in COLUMNS} | {"speed": speed, "fell": walk.status == "fell"}
    return kept | {"core_s": round(time.process_time() - began_s, 2)}


def walk_all(file: Path, worlds: int, first_world: int) -> list[dict[str, Any]]:
    """All episodes; those in the file are kept."""
    rows = [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
    known = {(row["family"], row["world"], row["method"]) for row in rows}
    for place, case in cases(worlds, first_world):
        if (place.family, place.number, case.method) in known:
            continue
        rows.append(episode(place, case))
        with file.open("a") as out:
            out.write(json.dumps(rows[-1]) + "\n")
    return rows


def table(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Rows of a Markdown table: means and their standard errors over the worlds."""
    robot = load_robot(ROBOT)
    built = {"ppo": policy_of(robot).origin, "trial-and-error": behaviours_of(robot).origin}
    lines = ["|method|n|speed over commanded|off the line at the end, cm|fell|trials|core s a walk|core min|"]
    lines.append("|---|--:|--:|--:|--:|--:|--:|--:|")
    for method in METHODS:
        some = [row for row in rows if row["method"] == method]
        ends = [100 * row["final_m"] for row in some if math.isfinite(row["final_m"])]
        trials, core_s = (np.mean([row[name] for row in some]) for name in ("trials", "core_s"))
        fell = sum(row["fell"] for row in some)
        before = built.get(method, {}).get("core_minutes", 0)
        speed, end = text_of([row["speed"] for row in some], 2), text_of(ends, 1)
        lines.append(f"|{method}|{len(some)}|{speed}|{end}|{fell}|{trials:.0f}|{core_s:.1f}|{before:g}|")
    return lines


def text_of(values: Sequence[float], digits: int) -> str:
    """Mean and standard error."""
    error = np.std(values, ddof=1) / math.sqrt(len(values))
    return f"{np.mean(values):.{digits}f} ± {error:.{digits}f}"


if __name__ == "__main__":
    numbers = [int(text) for text in sys.argv[2:4]]
    worlds, first_world = (*numbers, *(WORLDS, FIRST_WORLD)[len(numbers) :])
    print("\n".join(table(walk_all(Path(sys.argv[1]), worlds, first_world))))
