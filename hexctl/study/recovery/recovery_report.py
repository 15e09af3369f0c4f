"""Statistics of the recovery benchmark."""

import math
from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from hexctl.study.experiment import where
from hexctl.study.held_out_experiment import (
    Columns,
    Record,
    end_statistics,
    groups,
    mean_with_error,
    percentile,
    worlds_text,
)
from hexctl.study.paper.evidence import cm, cm_with_error, share_text, share_with_error
from hexctl.study.recovery.methods import NOTHING, method_of

if TYPE_CHECKING:
    from pandas import DataFrame, Series

#: A failure matters if it changes the end of a walk without a reaction by more than this, or its speed by
#: more than this share of the intact speed.
MATTERS_M, MATTERS_SHARE = 0.02, 0.10

#: The method that robots recover by.
JUDGED = "recover"


def compared(rows: "DataFrame") -> "DataFrame":
    """Return episodes of the protocol `line` next to the same walk intact, and with nothing done about it.

    Column `judged` is true for those of robots that make progress in that world while intact, `set_aside`
    for the others; both are false for intact walks and other protocols.
    """
    rows = rows.assign(
        n_legs=[len(legs) for legs in rows["legs"]],
        leg=[legs[0] if legs else 0 for legs in rows["legs"]],
        leg_set=[" and ".join(map(str, sorted(legs))) for legs in rows["legs"]],
        failure_kind=[_kind_of(failure) for failure in rows["failure"]],
    )
    rows["whole_leg"] = ~rows["failure"].str.contains(":") & (rows["failure"] != "stuck")
    place = ["protocol", "robot", "family", "world", "gait", "heading_deg"]
    numbers = ["status", "signed_m", "after_m_s"]
    intact = rows[rows["n_legs"] == 0].set_index(place)[numbers].add_prefix("intact_")
    left = rows[(rows["method"] == NOTHING) & (rows["n_legs"] > 0)]
    left = left.set_index([*place, "legs", "failure"])[["ended", *numbers]].add_prefix("left_")
    rows = rows.join(intact, on=place).join(left, on=[*place, "legs", "failure"])
    one_of_line = (rows["protocol"] == "line") & (rows["n_legs"] > 0)
    rows["judged"] = one_of_line & (rows["intact_status"] == "ok")
    rows["set_aside"] = one_of_line & ~rows["judged"]
    rows["speed_kept"] = (rows["after_m_s"] / rows["intact_after_m_s"]).where(one_of_line)
    rows["matters"] = _matters(rows).where(one_of_line, None)
    rows["intact_status"] = rows["intact_status"].where(one_of_line, None)
    return rows


def _matters(rows: "DataFrame") -> "Series[bool]":
    slower = (rows["left_after_m_s"] - rows["intact_after_m_s"]).abs()
    return (
        (rows["left_ended"] == False)  # noqa: E712  unknown for intact walks
        | ((rows["left_signed_m"] - rows["intact_signed_m"]).abs() > MATTERS_M)
        | (slower > MATTERS_SHARE * rows["intact_after_m_s"].abs())
    )


def _kind_of(failure: str) -> str:
    """Kind of a failure in few words, such as `locked` or `stuck joint`."""
    name, _, joint = failure.partition(":")
    return f"{name} joint" if joint else name


def divisions(rows: "DataFrame") -> Iterator[tuple[str, str, "DataFrame"]]:
    """Return name of a division, name of a group in it, and its judged episodes of all methods."""
    judged = rows[rows["judged"]]
    if len(judged):
        yield "all", "one leg or joint failed", judged
    if judged["whole_leg"].any():
        yield "kind", "whole legs", judged[judged["whole_leg"]]
    columns = {"kind": "failure_kind", "failure": "failure", "robot": "robot", "gait": "gait"}
    more = {"family": "family", "leg": "leg", "kind of world": "kind_of_world"}
    yield from groups(judged, columns | more)


def statistics(rows: "DataFrame") -> Record:
    """Return the statistics of some episodes of one method; standard errors over worlds, NaN for one world.

    `kept_worst` is the smallest mean over worlds of the speed kept by a robot, gait, leg and failure, 0 for a
    walk that fell.
    """
    matter, noticed = rows["matters"].to_numpy(bool), rows[rows["right_leg"].to_numpy(bool)]
    delays = noticed["delay_cycles"].to_numpy(float)
    kept, kept_error = mean_with_error(rows, "speed_kept")
    return {
        "episodes": len(rows),
        **end_statistics(rows, 99),
        "matter": int(matter.sum()),
        "right_leg": len(noticed),
        "right_kind": int((rows["right_kind"] & matter).sum()),
        "early": int((rows["early_alarms"] > 0).sum()),
        "delay_median": percentile(delays, 50),
        "delay_p95": percentile(delays, 95),
        "kept": kept,
        "kept_error": kept_error,
        "kept_worst": _worst_cell(rows),
        "trials": int(rows["trials"].sum()),
    }


def _worst_cell(rows: "DataFrame") -> float:
    kept = rows.assign(speed_kept=rows["speed_kept"].fillna(0.0).astype(float))
    return float(kept.groupby([*SET, "failure"])["speed_kept"].mean().min())


#: A set of legs counts for each robot and gait.
SET = ["robot", "gait", "leg_set"]


def rule_share(rows: "DataFrame") -> Record:
    """Return how many walks have recovered, and of how many sets of legs at least half have."""
    return {
        "recovered": int(rows["recovered"].sum()),
        "walks": len(rows),
        "fell": int((~rows["ended"].astype(bool)).sum()),
        "sets": int((rows.groupby(SET)["recovered"].mean() >= 0.5).sum()),
        "of_sets": len(rows.drop_duplicates(SET)),
    }


def counted(count: int, of: int) -> str:
    """Text of a count, its share, and Wilson's interval of that."""
    from scipy.stats import binomtest

    if not of:
        return "-"
    interval = binomtest(count, of).proportion_ci(method="wilson")
    return f"{count} of {of} ({share_text(count / of)}, {interval.low:.1%} to {interval.high:.1%})"


def _if_noticing(text: Any) -> Any:
    """Text of a cell, or a dash for a method that notices no failures."""
    return lambda one: text(one) if method_of(one["method"]).notices else "-"


COLUMNS: Columns = {
    "": itemgetter("group"),
    "method": itemgetter("method"),
    "walks": lambda one: worlds_text(one["episodes"], one["worlds"]),
    "right leg": _if_noticing(lambda one: counted(one["right_leg"], one["episodes"])),
    "right kind, of those that matter": _if_noticing(lambda one: counted(one["right_kind"], one["matter"])),
    "alarm after: median, 95th percentile (cycles)": _if_noticing(
        lambda one: f"{one['delay_median']:.2f}, {one['delay_p95']:.2f}" if one["right_leg"] else "-"
    ),
    "early alarms": _if_noticing(lambda one: str(one["early"])),
    "final: mean": lambda one: cm_with_error(one["mean_m"], one["mean_error_m"]),
    "99th percentile": lambda one: cm(one["p99_m"]),
    "maximum": lambda one: cm(one["max_m"]),
    "during the walk: 99th percentile": lambda one: cm(one["way_p99_m"]),
    "fell": lambda one: counted(one["fell"], one["episodes"]) if one["fell"] else "0",
    "stopped": lambda one: str(one["others"]),
    "no progress": lambda one: str(one["no_progress"]),
    "speed kept": lambda one: share_with_error(one["kept"], one["kept_error"]),
    "worst cell": lambda one: _number(one["kept_worst"]),
    "trials before, each": lambda one: f"{one['trials'] / one['episodes']:.3g}" if one["trials"] else "0",
}

RULE_TITLES = {"hexaheal": "HexaHeal's protocol", "second": "A second leg"}


def rule_shares(rows: "DataFrame", methods: Sequence[str], counts: Sequence[int]) -> list[Record]:
    """Return the walks that recover, by number of failed legs and method."""
    return [
        {"legs": count, "method": method} | rule_share(where(rows, method=method, n_legs=count))
        for count in counts
        for method in methods
    ]


RULE_COLUMNS: Columns = {
    "legs that fail": lambda one: {1: "one", 2: "two"}[one["legs"]],
    "method": itemgetter("method"),
    "walks that recover": lambda one: counted(one["recovered"], one["walks"]),
    "fell or stopped": lambda one: str(one["fell"]),
    "sets of legs that recover": lambda one: f"{one['sets']} of {one['of_sets']}",
}


def aside_lines(rows: "DataFrame") -> list[str]:
    """Return the omissions from all numbers, in words; nothing if there are none."""
    aside = rows[rows["set_aside"]]
    places = dict.fromkeys(aside["robot"] + " in " + aside["place"])
    if not places:
        return []
    return [
        f"counted apart: {len(aside)} walks in which the robot makes no progress with six good legs "
        f"({', '.join(places)})"
    ]


def _number(value: float) -> str:
    """Text of a number; a dash if no walk was long enough for it."""
    return f"{value:.2f}" if math.isfinite(value) else "-"


def table_of_walks(rows: "DataFrame") -> "DataFrame":
    """Return the table of all walks as it is written."""
    legs = ["n_legs", "leg", "leg_set", "whole_leg", "failure_kind"]
    used = ["judged", "set_aside", "ended", "place", "intact_signed_m", "intact_after_m_s"]
    return rows.drop(columns=[*legs, *used, *rows.filter(like="left_")])
