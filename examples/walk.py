"""Walk once in a world that is not perfect, with and without feedback, and save both paths as a picture.

Run it with `python examples/walk.py`.
"""

import hexctl

axes = None
for hold in ("line", "none"):
    walk = hexctl.run(gait="tripod", hold=hold, world="randomised:7", duration_s=10)
    print(f"{hold}: {walk.trial}")
    axes = walk.trial.plot(axes)
    axes.lines[-1].set_label(hold)
axes.legend()
axes.figure.savefig("walk.png")
