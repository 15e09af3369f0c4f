"""Compare a custom recovery with those of hexctl: change to a wave gait, whichever leg fails.

Run it with `python examples/own_recovery.py`. `hexctl run --recovery own_recovery:ToWave` uses it, too.
"""

import hexctl
from hexctl.extension import Recovery, Response


class ToWave(Recovery):
    """Changes to a wave gait, whichever leg fails."""

    def respond(self, robot, plan, heading_body_rad, failures):
        return Response(gait=hexctl.make_gait(robot, "wave"))


if __name__ == "__main__":
    for name, recovery in {"walk-on": "walk-on", "glide": "glide", "to wave": ToWave()}.items():
        done = hexctl.run(failure="2:limp@3", recovery=recovery, duration_s=10, record=False)
        print(f"{name}: {done.trial}")
