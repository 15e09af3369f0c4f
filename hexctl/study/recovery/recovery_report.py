"""Statistics, bars and the figure of the recovery benchmark."""

import math
from collections.abc import Iterator, Sequence
from operator import itemgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.palette import OTHER_REMEDY_COLORS, REMEDY_COLORS, hex_color
from hexctl.study.data_frames import where
from hexctl.study.held_out_experiment import (
    Columns,
    Record,
    end_statistics,
    groups,
    mean_with_error,
    percentile,
    worlds_text,
)
from hexctl.study.paper.evidence import (
    Bar,
    cm,
    cm_with_error,
    judged_bars,
    limit_text,
    share_text,
    share_with_error,
    wilson_interval,
)
from hexctl.study.recovery.methods import NOTHING, TOLD, method_of
from hexctl.study.report_page import Table
from hexctl.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame, Series

#: A failure matters if it changes the end of a walk without a reaction by more than this, or its speed by
#: more than this share of the intact speed.
MATTERS_M, MATTERS_SHARE = 0.02, 0.10

#: The judged method.
JUDGED = "recover"

#: Number of episodes needed to judge falls and the right leg, and the joints of failures that matter.
ENOUGH, ENOUGH_JOINTS = 1000, 100

#: Colours of the methods, and of any other one.
METHOD_COLORS = dict(zip((NOTHING, TOLD, JUDGED), map(hex_color, REMEDY_COLORS), strict=True))
OTHER_COLORS = tuple(map(hex_color, OTHER_REMEDY_COLORS))

#: Lower end of the scale of deviations, in cm.
LOW_CM = 0.01

#: Columns that may be empty have a type all the same, so that tables can be joined.
TYPES = {
    "noticed_leg": "Int64",
    "matters": "boolean",
    **dict.fromkeys(("why", "noticed_kind", "noticed_joint", "noticed_evidence", "intact_status"), "string"),
    **dict.fromkeys(("delay_s", "delay_cycles", "final_m", "speed_kept"), "Float64"),
}


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
    known = np.isfinite(rows["speed_kept"].to_numpy(float))
    settled_s = rows["settled_s"][known].fillna(math.inf).to_numpy(float)
    kept, kept_error = mean_with_error(rows, "speed_kept")
    return {
        "episodes": len(rows),
        **end_statistics(rows, 99),
        "matter": int(matter.sum()),
        "right_leg": len(noticed),
        "right_kind": int((rows["right_kind"] & matter).sum()),
        "early": int((rows["early_alarms"] > 0).sum()),
        "again": sum(len(alarms) > 1 for alarms in rows["alarms"]),
        "delay_median": percentile(delays, 50),
        "delay_p95": percentile(delays, 95),
        "kept": kept,
        "kept_error": kept_error,
        "kept_worst": _worst_cell(rows),
        "settled_median_s": percentile(settled_s, 50),
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
        "sets": len(recovering(rows)),
        "of_sets": len(rows.drop_duplicates(SET)),
    }


def recovering(rows: "DataFrame") -> set[Any]:
    """Return the sets of legs of which at least half of the walks have recovered."""
    shares = rows.groupby(SET)["recovered"].mean()
    return set(shares.index[shares >= 0.5])


def counted(count: int, of: int) -> str:
    """Text of a count, its share, and the interval of that."""
    if not of:
        return "-"
    low, high = wilson_interval(count, of)
    return f"{count} of {of} ({share_text(count / of)}, {low:.1%} to {high:.1%})"


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
    "worst cell": lambda one: _number(one["kept_worst"], ".2f"),
    "90 % after": lambda one: _number(one["settled_median_s"], ".2f", " s"),
    "trials before, each": lambda one: f"{one['trials'] / one['episodes']:.3g}" if one["trials"] else "0",
}

RULE_TITLES = {"hexaheal": "HexaHeal's protocol", "second": "A second leg"}


def rule_shares(
    rows: "DataFrame", methods: Sequence[str], column: str, values: Sequence[Any]
) -> list[Record]:
    """Return the walks that recover, by the values of a column, such as sets of legs, and method."""
    return [
        {"legs": value, "method": method} | rule_share(where(rows, method=method, **{column: value}))
        for value in values
        for method in methods
    ]


RULE_COLUMNS: Columns = {
    "legs that fail": lambda one: {1: "one", 2: "two"}[one["legs"]],
    "method": itemgetter("method"),
    "walks that recover": lambda one: counted(one["recovered"], one["walks"]),
    "fell or stopped": lambda one: str(one["fell"]),
    "sets of legs that recover": lambda one: f"{one['sets']} of {one['of_sets']}",
}


def set_table(rows: "DataFrame", methods: Sequence[str]) -> Table:
    """Return the table of walks that recover, a row for each set of legs and a column for each method."""
    cells = rows.groupby(["leg_set", "method"], sort=False)["recovered"].agg(["sum", "count"])
    texts = [f"{one['sum']} of {one['count']}" for one in cells.to_dict("records")]
    table = cells.assign(text=texts)["text"].unstack("method", sort=False)
    shown = table.reindex(columns=list(methods), fill_value="0 of 0")
    return Table(("legs that fail", *methods), [[str(legs), *row] for legs, *row in shown.itertuples()])


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


def _number(value: float, form: str, unit: str = "", *, never: str = "-") -> str:
    """Text of a number with its unit; a dash if no walk was long enough for it."""
    if math.isinf(value):
        return never
    return "-" if math.isnan(value) else f"{value:{form}}{unit}"


def table_of_walks(rows: "DataFrame") -> "DataFrame":
    """Return the table of all walks as it is written; columns have the same types in each plan."""
    from pandas import ArrowDtype
    from pyarrow import float64, int64, list_, string, struct

    hidden = [
        "n_legs",
        "leg",
        "leg_set",
        "failure_kind",
        "whole_leg",
        "judged",
        "set_aside",
        "ended",
        "place",
    ]
    hidden += [name for name in rows if name.startswith("left_")] + ["intact_signed_m", "intact_after_m_s"]
    alarm = {"at_s": float64(), "leg": int64(), "kind": string(), "joint": string(), "evidence": string()}
    lists = {"alarms": list_(struct(list(alarm.items()))), "legs": list_(int64())}
    types = TYPES | {name: ArrowDtype(kind) for name, kind in lists.items()}
    return rows.drop(columns=hidden).astype(types)


def recovery_bars(rows: "DataFrame", duration_s: float) -> list[Bar]:
    """Return the bars that `recover` reaches; those of lines are not judged on too short walks."""
    if JUDGED not in set(rows["method"]):
        return []
    bars: list[Bar] = []
    judged = rows[rows["judged"] & (rows["method"] == JUDGED)]
    if (rows["protocol"] == "line").any():
        bars = [*_alarm_bars(judged, rows[rows["n_legs"] == 0]), *_walk_bars(judged)]
    return [*judged_bars(bars, duration_s), *_rule_bars(rows), *_second_bars(rows)]


def _alarm_bars(rows: "DataFrame", intact: "DataFrame") -> Iterator[Bar]:
    whole, matters = rows["whole_leg"], rows["matters"].astype(bool)
    legs, joints = statistics(rows[whole]), statistics(rows[~whole & matters])
    what = "whole legs: the right one accused"
    yield _share_bar("right_leg", what, legs["right_leg"], legs["episodes"], (0.99, 0.999), ENOUGH)
    what = "single joints that matter: leg, joint and kind right"
    counts = joints["right_kind"], joints["matter"]
    yield _share_bar("right_joint", what, *counts, (0.95, 0.99), ENOUGH_JOINTS)
    both = statistics(rows[whole | matters])
    yield Bar(
        name="delay",
        asked="failure to alarm: median at most 0.5, 95th percentile at most 1 cycle",
        measured=f"median {both['delay_median']:.2f}, 95th percentile {both['delay_p95']:.2f}",
        holds=bool(both["delay_median"] <= 0.5 and both["delay_p95"] <= 1.0),
    )
    healthy, aside = intact[intact["status"] == "ok"], intact[intact["status"] != "ok"]
    alarms, early = int(healthy["early_alarms"].sum()), int((rows["early_alarms"] > 0).sum())
    yield Bar(
        name="false_alarms",
        asked="no false alarm in healthy walking",
        measured=f"{alarms} in {sum(healthy['duration_s']) / 3600:.2f} h of intact walks; {early} of "
        f"{len(rows)} episodes had one before the failure; {aside['early_alarms'].sum()} in {len(aside)} "
        "intact walks without progress",
        holds=alarms + early == 0,
    )


def _walk_bars(rows: "DataFrame") -> Iterator[Bar]:
    found, legs = statistics(rows), statistics(rows[rows["whole_leg"]])
    yield Bar(
        name="settled",
        asked="failure to 90 % of the later speed: median at most 2.5 s (stretch: 1.5 s)",
        measured=_number(found["settled_median_s"], ".2f", " s", never="never"),
        holds=bool(found["settled_median_s"] <= 2.5),
    )
    yield Bar(
        name="deviation",
        asked=f"deviation from the original line at the end: mean at most {limit_text(0.008)}, "
        f"99th percentile at most {limit_text(0.04)} (stretch: {limit_text(0.004)}, {limit_text(0.025)})",
        measured=f"mean {cm(found['mean_m'])}, 99th percentile {cm(found['p99_m'])}",
        holds=bool(found["mean_m"] <= 0.008 and found["p99_m"] <= 0.04),
    )
    failed = found["fell"] + found["others"]
    enough = found["episodes"] >= ENOUGH or failed > 0
    yield Bar(
        name="falls",
        asked=f"no fall in {ENOUGH} or more episodes",
        measured=f"{found['fell']} fell, {found['others']} diverged or were stopped, of {found['episodes']}",
        holds=failed == 0 if enough else None,
        not_judged="" if enough else f"{found['episodes']} episodes, needs {ENOUGH}",
    )
    kept = [_number(legs[name], ".1%", never="never") for name in ("kept", "kept_worst")]
    yield Bar(
        name="kept",
        asked="whole legs: speed kept against intact at least 80 % (stretch: 90 %), in the worst of robot, "
        "gait, leg and kind 60 %",
        measured="mean {}, worst {}".format(*kept),
        holds=bool(legs["kept"] >= 0.8 and legs["kept_worst"] >= 0.6),
    )


def _rule_bars(rows: "DataFrame") -> Iterator[Bar]:
    pairs = rows[(rows["protocol"] == "hexaheal") & (rows["n_legs"] == 2) & (rows["method"] == JUDGED)]
    found = rule_share(pairs)
    if found["of_sets"]:
        yield Bar(
            name="pairs",
            asked="HexaHeal's rule: pairs of legs that recover in at least half of the walks: 12 of 15 "
            "(stretch: 15)",
            measured=f"{found['sets']} of {found['of_sets']}; {found['recovered']} of {found['walks']} walks",
            holds=found["sets"] / found["of_sets"] >= 12 / 15,
        )


def _second_bars(rows: "DataFrame") -> Iterator[Bar]:
    """Bar of the pairs that recover by themselves, among those that recover by the oracle."""
    second = rows[rows["protocol"] == "second"]
    told, judged = (second[second["method"] == method] for method in (TOLD, JUDGED))
    if not len(told):
        return
    able = recovering(told)
    judged = judged[[key in able for key in judged[SET].itertuples(index=False, name=None)]]
    recover = len(recovering(judged))
    yield Bar(
        name="second",
        asked="a second leg 10 s after the first: pairs that recover in at least half of the walks, of those "
        "that do when told: 80 %",
        measured=f"{recover} of {len(able)} (of {len(told.drop_duplicates(SET))} pairs); "
        f"{judged['recovered'].sum()} of {len(judged)} walks",
        holds=recover >= 0.8 * len(able) if able else None,
        not_judged="" if able else "no pair recovers with the failure known",
    )


def _share_bar(name: str, what: str, count: int, of: int, least: tuple[float, float], enough: int) -> Bar:
    """Bar of a minimum share with its stretch goal; not judged on few episodes."""
    return Bar(
        name=name,
        asked=f"{what}: at least {least[0]:.0%} (stretch: {least[1]:.1%}), of {enough} or more",
        measured=counted(count, of),
        holds=count >= least[0] * of if of >= enough else None,
        not_judged="" if of >= enough else f"{of} episodes, needs {enough}",
    )


def recovery_figure(methods: Sequence[str], rows: "DataFrame", title: str) -> "Figure":
    """Draw final deviation and speed kept, by kind of failure and method."""
    from matplotlib.figure import Figure

    kinds = [(name, some) for division, name, some in divisions(rows) if division == "kind"]
    size_in = (10.0, 1.2 + 0.25 * len(kinds) * (len(methods) + 1))
    figure = Figure(figsize=size_in, layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    for place, method in enumerate(methods):
        color = METHOD_COLORS.get(method, OTHER_COLORS[place % len(OTHER_COLORS)])
        for row, (_, judged) in enumerate(kinds):
            some = where(judged, method=method)
            height = row + 0.8 * (place + 0.5) / len(methods) - 0.4
            label = method if row == 0 else None
            _spread(left, np.maximum(100 * some["final_m"].to_numpy(float), LOW_CM), height, color, label)
            _spread(right, some["speed_kept"].to_numpy(float), height, color, None)
    _finish(left, right, [name for name, _ in kinds])
    figure.suptitle(title, fontsize=11)
    if left.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=len(methods), fontsize=8)
    return figure


def _spread(panel: "Axes", values: FloatArray, height: float, color: str, label: str | None) -> None:
    """Draw the mean as a dot and the 1st to 99th percentile as a line."""
    values = values[np.isfinite(values)]
    if not values.size:
        return
    low, high = np.percentile(values, [1, 99])
    panel.plot([low, high], [height, height], color=color, linewidth=2.0, alpha=0.6)
    panel.plot([values.mean()], [height], "o", color=color, markersize=5, label=label)


def _finish(left: "Axes", right: "Axes", names: list[str]) -> None:
    left.set_xscale("log")
    left.set_xlim(left=LOW_CM)
    left.set_xlabel("deviation from the original line at the end in cm", fontsize=9)
    right.set_xlabel("later speed over that of the intact walk", fontsize=9)
    right.set_xlim(left=0.0)
    left.set_yticks(range(len(names)), names)
    left.set_ylim(len(names) - 0.5, -0.5)
    for panel in (left, right):
        panel.grid(visible=True, axis="x", linewidth=0.3)
        panel.tick_params(axis="y", length=0)
