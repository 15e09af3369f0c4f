"""A check of a robot in the terminal: its verdict, findings, margins and tables."""

import math
from typing import TYPE_CHECKING, Any

from rich.text import Text

from hexctl.cli.render.tables import label_table, plain_table

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table


#: Most lines without --verbose, unless the verdict has more.
MOST_LINES = 12


def report_parts(report: dict[str, Any], *, verbose: bool) -> "list[RenderableType]":
    """Findings and tables of a report, for printing."""
    parts: list[RenderableType] = [*_findings(report, verbose=verbose), *_physics(report)]
    if "envelope" in report:
        parts += ["", *ENVELOPE, _envelope_table(report["envelope"])]
    if "leg_sets" in report:
        parts += ["", _leg_set_table(report["leg_sets"])]
    return parts


def _findings(report: dict[str, Any], *, verbose: bool) -> "list[RenderableType]":
    first: list[RenderableType] = [_conclusion(report), *_heading(report)]
    verdict, others = _verdict(report), _others(report)
    if verbose:
        return [*first, "", *verdict, *others, "", _joint_table(report)]
    room = max(0, MOST_LINES - len(first) - len(verdict) - 1)
    kept, left = [*verdict, *others[:room]], len(others[room:])
    more = f"{left} more finding{'s' * (left > 1)} and " if left else ""
    return [*first, *kept, f"--verbose prints {more}the load of each joint"]


def _heading(report: dict[str, Any]) -> list[str]:
    slots = ",".join(str(slot) for slot in report["gait"]["slots"])
    return [
        *_assumed(report["to_measure"]),
        f"{report['robot']}: {report['mass_kg']:g} kg, stands {report['standing_height_m']:g} m high",
        f"gait slots {slots} at {report['gait']['pace_hz']:g} Hz: "
        f"ideal speed {report['ideal_speed_m_s']:g} m/s",
        f"failures detected: {report['detects']}",
        *([f"meshes for {', '.join(report['meshes'])}, solids for the rest"] if report["meshes"] else []),
    ]


def _assumed(to_measure: list[str]) -> list[str]:
    """Line that says whether the limits on which the conclusion depends are guesses."""
    from hexctl.types import JOINT_KINDS

    def unknown(name: str) -> bool:
        paths = {"joints", *(f"joints.{kind}{end}" for kind in JOINT_KINDS for end in ("", f".{name}"))}
        return not paths.isdisjoint(to_measure)

    limits = {"max_torque_nm": "torque", "max_speed_deg_s": "speed"}
    names = [text for name, text in limits.items() if unknown(name)]
    if not names:
        return []
    are = "are" if len(names) > 1 else "is"
    return [f"{' and '.join(names)} of joints {are} assumed (`unknown` in the file): measure first"]


#: Rows of the envelope's table.
ENVELOPE = (
    "envelope: largest velocity commands, by which steered walks and VelocityWalk go, and smallest static",
    "margin of the most stable gait there. Strokes are 1.2 amplitudes at most, every foot in reach, every",
    "joint in its range; how fast joints turn is not part of it: where `speed` is not kept, the guard clips.",
)


def _envelope_table(envelope: dict[str, Any]) -> "Table":
    speeds_m_s, margins_m = envelope["speeds_m_s"], envelope["static_margins_m"]
    table = plain_table("without leg", *("none" if name == "intact" else name for name in speeds_m_s))
    table.add_row("turn, deg/s", *(f"{envelope['turn_rates_deg_s'][name]:.0f}" for name in speeds_m_s))
    for number, direction in enumerate(envelope["directions_deg"]):
        table.add_row(f"{direction:g} deg, m/s", *(f"{row[number]:.3f}" for row in speeds_m_s.values()))
        table.add_row("  margin, cm", *(f"{100 * margins_m[name][number]:+.1f}" for name in speeds_m_s))
    return table


#: Texts of verdicts on sets of lost legs.
VERDICTS = {
    "walks": "with a gait whose body stays over its feet, or nearly",
    "crawls": "slower: one leg at a time swings",
    "doubtful": "leans further than robots that walked: it may fall or hardly move; hexctl run notes it",
    "no gait": "two feet or fewer stand while one swings; hexctl run --gait auto refuses it",
}


def _leg_set_table(sets: list[dict[str, Any]]) -> "Table":
    groups: dict[tuple[int, str], list[dict[str, Any]]] = {}
    for one in sets:
        groups.setdefault((len(one["legs"]), one["verdict"]), []).append(one)
    rows = [("margin", "the smallest over the gait cycle, as a share of the radius of the stance")]
    for (count, verdict), group in sorted(groups.items(), key=lambda item: (item[0][0], -_best(item[1]))):
        margins = [one["margin"] for one in group if one["margin"] is not None]
        whole = len(group) == math.comb(6, count)
        names = (
            f"any of {len(group)}" if whole else ", ".join("+".join(map(str, one["legs"])) for one in group)
        )
        span = f"; margin {min(margins):+.2f} to {max(margins):+.2f}" if margins else ""
        rows.append((f"without {count} leg{'s' * (count > 1)}", f"{verdict}: {names}{span}"))
    found = {verdict for _, verdict in groups}
    return label_table([*rows, *((verdict, text) for verdict, text in VERDICTS.items() if verdict in found)])


def _best(sets: list[dict[str, Any]]) -> float:
    return max((one["margin"] for one in sets if one["margin"] is not None), default=-math.inf)


def _joint_table(report: dict[str, Any]) -> "Table":
    table = plain_table(
        "joint", "needs (deg)", "range (deg)", "peak deg/s", "limit", "holds N m", "limit", ""
    )
    table.padding = (0, 1, 0, 0)
    for name, row in report["joints"].items():
        peak, limit = row["peak_speed_deg_s"], row["max_speed_deg_s"]
        torque, most = row["static_torque_nm"], row["max_torque_nm"]
        marks = ["out of range"] if name in report["joints_out_of_range"] else []
        marks += ["too fast"] if peak > limit else []
        marks += ["too weak"] if torque > most else []
        table.add_row(
            name,
            f"{row['lowest_deg']:.1f} .. {row['highest_deg']:.1f}",
            f"{row['min_deg']:g} .. {row['max_deg']:g}",
            f"{peak:.0f}",
            f"{limit:.0f}",
            f"{torque:.2g}",
            f"{most:.2g}",
            ", ".join(marks),
        )
    return table


def _verdict(report: dict[str, Any]) -> list[str]:
    legs = ", ".join(str(leg) for leg in report["unreachable_legs"])
    outside = ", ".join(report["joints_out_of_range"])
    pace = report["max_pace_hz"]
    upto = "" if pace is None else f" up to {pace:g} Hz"
    return [
        f"reach: out of reach for leg {legs}" if legs else "reach: every foot position is in reach",
        f"range: exceeded by {outside}" if outside else "range: kept by every joint",
        f"speed: kept{upto}"
        if report["speed_holds"]
        else f"speed: too fast, the guard clips it{upto and f'; kept{upto}'}",
        _torque(report),
        *([_stance(report)] if report["proposed_five_leg_drive"] != report["five_leg_drive"] else []),
        *(f"warning: {warning}" for warning in report["warnings"]),
        *_load_verdicts(report),
    ]


def _others(report: dict[str, Any]) -> list[str]:
    """Findings that --verbose adds."""
    from hexctl.robot.sensors import in_words

    spacing = report["least_foot_spacing_m"]
    return [
        f"sensors: {in_words(report['sensors'])}",
        *_servo_verdicts(report),
        *([f"feet: {spacing:g} m apart or more"] if report["feet_stay_apart"] else []),
        *([_stance(report)] if report["proposed_five_leg_drive"] == report["five_leg_drive"] else []),
        *_to_measure(report),
    ]


def _torque(report: dict[str, Any]) -> str:
    weak = [name for name, row in report["joints"].items() if row["static_torque_nm"] > row["max_torque_nm"]]
    too_weak = f", too weak: {_joints(weak)}" if weak else ""
    share, capacity = report["static_torque_share"], report["load_capacity"]
    if report["tipping"] == 1:
        return "torque: not known, since the robot tips over all the time"
    return (
        f"torque: standing takes up to {100 * share:.0f} % of the limit; "
        f"the legs carry {capacity:.3g} x the weight{too_weak}"
    )


def _stance(report: dict[str, Any]) -> str:
    """Share of the torque on five legs, and the stance that `stance_width` proposes."""
    own_m, drive = report["stance_outward_m"], report["five_leg_drive"]
    other_m, other = report["proposed_outward_m"], report["proposed_five_leg_drive"]
    needs = (
        "its legs do not reach the floor, or it tips over,"
        if drive is None
        else f"joints need up to {100 * drive:.0f} % of their torque"
    )
    text = f"stance: after the loss of a leg {needs} at outward_m {own_m:g}"
    if drive is not None and drive <= 1:
        return text
    if other is None:
        return f"{text} and at narrower ones"
    return f"{text}; proposed: {other_m:g} ({100 * other:.0f} %)"


def _load_verdicts(report: dict[str, Any]) -> list[str]:
    from hexctl.control.checks.gait_load import CONTINUOUS_SHARE

    one, other = report["nearest_legs"]
    gap_mm = 1000 * report["least_leg_clearance_m"]
    near = f"overlap by {-gap_mm:.0f} mm" if report["legs_touch"] else f"come within {gap_mm:.0f} mm"
    return [
        f"legs: {one} and {other} {near}",
        f"sag: joints give way by up to {report['sag_deg']:.1f} deg, the body sinks "
        f"{report['sag_mm']:.1f} of the {report['step_height_mm']:g} mm of a step",
        f"heat: more than {100 * CONTINUOUS_SHARE:.0f} % of the torque for "
        f"{100 * report['duty']:.0f} % of the cycle",
    ]


def _physics(report: dict[str, Any]) -> list[str]:
    if "physics" not in report:
        return []
    found = report["physics"]
    whole, solver, contact = (
        f"{100 * found[name]:.1f} cm" for name in ("numerical_m", "solver_m", "contact_m")
    )
    return [
        "",
        f"simulation: walks of {found['duration_s']:g} s end ± {whole} from half the time step "
        f"(rms of {found['walks']} walks)",
        f"not in the ±: {solver} by MuJoCo's default solver tolerance,",
        f"{contact} on a floor a third softer or harder",
    ]


def _servo_verdicts(report: dict[str, Any]) -> list[str]:
    unit, limits = (
        ("pulses", "min_us, max_us") if "pulses_us" in report else ("counts", "min_count, max_count")
    )
    beyond, travel = report[f"joints_beyond_{unit}"], report.get("joints_beyond_travel", [])
    lines = []
    if travel:
        lines.append(f"servos: range beyond all counts that the servo has for {_joints(travel)}")
    if narrow := [name for name in beyond if name not in travel]:
        what = "pulse limits" if unit == "pulses" else limits
        lines.append(f"servos: range beyond the {what} for {_joints(narrow)}")
    if lines:
        gait = "this gait is not" if report[f"gait_fits_{unit}"] else "this gait too"
        lines[-1] += f"; {'a board' if unit == 'pulses' else 'the bus'} clips it, {gait}"
    else:
        what = "pulse limits" if unit == "pulses" else f"counts of its servo ({limits})"
        lines = [f"servos: every range fits into the {what}"]
    return lines


def _to_measure(report: dict[str, Any]) -> list[str]:
    unknown = ", ".join(report["to_measure"])
    return [f"to measure: {unknown}; the values in the file are plausible, not known"] if unknown else []


def _joints(names: list[str]) -> str:
    from hexctl.types import N_LEGS

    kinds = {"coxa": "all coxae", "femur": "all femurs", "tibia": "all tibiae"}
    texts = []
    for kind, text in kinds.items():
        own = [name for name in names if name.endswith(kind)]
        texts += [text] if len(own) == N_LEGS else own
    return ", ".join(texts)


def _conclusion(report: dict[str, Any]) -> Text:
    robot, warned = report["robot"], ", see the warnings" if report["warnings"] else ""
    if not report["possible"]:
        return Text(f"{robot} cannot walk this gait", style="bold red")
    if report["doubtful"]:
        return Text(f"{robot} may not be able to walk this gait{warned}", style="bold yellow")
    if not report["speed_holds"]:
        return Text(f"{robot} can walk this gait, clipped at its fastest{warned}", style="bold yellow")
    return Text(f"{robot} can walk this gait{warned}", style="bold green")
