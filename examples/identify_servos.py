"""Find stiffness, friction and dead time of a robot's servos from logs.

Logs are recordings of a robot on a stand (.rrd, made by `hexctl identify`), or runs of one servo on a bench
(.json). Run it with `python examples/identify_servos.py LOG...`.
"""

import sys

from hexctl.identify.identification import identify

if len(sys.argv) == 1:
    raise SystemExit("usage: python examples/identify_servos.py LOG...; hexctl identify makes a log")
found = identify(sys.argv[1:])
for name, estimate in found.estimates.items():
    doubt = "" if estimate.known else ", which these logs do not determine"
    print(f"{name}: {estimate.value:.3g} {estimate.unit}{doubt}")
