"""Record a walk and export it as a table with one row per control period.

Run it with `python examples/export_walk.py`. Use `to="mcap"`, `"parquet"` or `"lerobot"` for other formats.
"""

import csv

import hexctl

done = hexctl.run(duration_s=3, record="walk.rrd")
table = hexctl.export("walk.rrd", to="csv", output="walk.csv")
with open(table) as file:
    rows = list(csv.DictReader(file))
print(f"{len(rows)} rows in {table}; columns {', '.join(rows[0])[:60]} ...")
print(f"{done.trial.distance_m:.2f} m walked")
