"""Recordings, sessions and robots in the formats of other programs: `hexctl.export("walk.rrd", to="mcap")`.

Its parameters: `help(hexctl.export.__call__)`.
"""

from hexctl.lazy_names import make_callable

make_callable(__name__, "export")
