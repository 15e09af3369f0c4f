"""Walk several gaits on floors of different slope, all trials in parallel, and print how far each drifts.

Run it with `python examples/sweep.py`.
"""

from itertools import product

import hexctl

robot = hexctl.load_robot("ant")
gaits, slopes_deg = ("tripod", "ripple", "wave"), (0.0, 3.0, 6.0)
trials = [
    hexctl.SimTrial(
        robot=robot,
        plan=hexctl.TrialPlan(gait=hexctl.make_gait(robot, gait), duration_s=8),
        failures=None,
        world=hexctl.World(slope_deg=slope_deg, slope_direction_deg=90),  # uphill to the left
    )
    for gait, slope_deg in product(gaits, slopes_deg)
]
results = dict(zip(product(gaits, slopes_deg), hexctl.run_sim_trials(trials), strict=True))

print("slope", *(f"{slope_deg:g} deg" for slope_deg in slopes_deg), sep="\t")
for gait in gaits:
    ends_cm = [100 * results[gait, slope_deg].deviation.signed for slope_deg in slopes_deg]
    print(gait, *(f"{end_cm:.1f} cm" for end_cm in ends_cm), sep="\t")
