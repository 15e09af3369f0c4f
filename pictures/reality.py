"""Pictures of how real the simulation is: servos on a bench, and open-loop walks in worlds of `real`.

The measured files stay outside the project: a picture has errors and facts, no measured curves.
"""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from benchmarks.reality import lukas_servo, open_loop_walks, sts3215_judged_runs
from hexctl.identify.fit import mean_errors_rad
from hexctl.palette import BEST_COLOR, hex_color
from pictures.picture import INK, READABLE, save_svg

#: Robots of lukas/hexapod: share of the commanded distance and turn in degrees of one open-loop walk.
MEASURED = {"robot 1": (0.29, 10.0), "robot 2": (0.70, 60.0)}


def draw_servo_terms(folder: Path) -> Path:
    """Draw the error of the servo of lukas on held-out runs of an STS3215, and without each of its terms."""
    servo = lukas_servo()
    servos = {
        "as in lukas.yaml": servo,
        "without dead time": replace(servo, dead_time_s=0.0),
        "without rotor inertia": replace(servo, rotor_inertia_kg_m2=1e-5),
        "without friction": replace(servo, dry_friction_nm=1e-4, gear_damping_nm_s_per_rad=1e-4),
        "without back-EMF": replace(servo, no_load_speed_rad_s=np.inf),
    }
    runs = sts3215_judged_runs()
    with mpl.rc_context(READABLE):
        figure = Figure(figsize=(9.0, 3.2), layout="constrained")
        ax = figure.subplots()
        for place, values in enumerate(reversed(servos.values())):
            errors_deg = np.degrees(list(mean_errors_rad(runs, values).values()))
            color = hex_color(BEST_COLOR) if values is servo else INK
            low, high = np.quantile(errors_deg, (0.1, 0.9))
            mean = float(errors_deg.mean())
            ax.plot([low, high], [place, place], color=color, linewidth=5)
            ax.plot(mean, place, "o", color=color, markersize=14)
            ax.annotate(f"{mean:.1f}°", (high, place), (10, 0), textcoords="offset points", va="center")
        ax.set_yticks(range(len(servos)), list(reversed(servos)), fontsize=13)
        ax.set_ylim(-0.5, len(servos) - 0.5)
        ax.set_xlim(left=0.0)
        ax.set_xlabel(f"mean error of the angle in {len(runs)} held-out runs (dot: mean, bar: 10 to 90 %)")
        return save_svg(figure, folder / "servo_terms.svg")


def draw_real_walks(folder: Path) -> Path:
    """Draw distance and turn of open-loop walks in worlds of `real`, beside two real robots."""
    shares, turns_deg = np.array(open_loop_walks()).T
    with mpl.rc_context(READABLE):
        figure = Figure(figsize=(9.0, 3.4), layout="constrained")
        ax = figure.subplots()
        ax.plot(shares, np.abs(turns_deg), "o", color=INK, markersize=7, label="worlds of real")
        for number, (name, (share, turn_deg)) in enumerate(MEASURED.items()):
            label = "real robots" if number == 0 else None
            ax.plot(share, turn_deg, "*", color=hex_color(BEST_COLOR), markersize=18, label=label)
            ax.annotate(name, (share, turn_deg), (14, 0), textcoords="offset points", va="center")
        ax.set_xlim(0.0, 1.1)
        ax.set_ylim(0.0, 70.0)
        ax.set_xlabel("distance travelled, share of the commanded distance")
        ax.set_ylabel("turn in 30 s, degrees")
        ax.legend(loc="upper left")
        return save_svg(figure, folder / "real_walks.svg")
