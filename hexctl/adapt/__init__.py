"""Finding a gait for a failed leg: `hexctl.adapt(failed_leg=5)` searches, the modules here are its parts.

Its parameters: `help(hexctl.adapt.__call__)`.
"""

from hexctl.callable_package import make_callable

make_callable(__name__, "adaptation")
