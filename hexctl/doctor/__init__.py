"""What this computer has and what works on it, for bug reports: `hexctl.doctor()`.

Its parameters: `help(hexctl.doctor.__call__)`.
"""

from hexctl.callable_package import make_callable

make_callable(__name__, "checkup")
