"""The paper's experiments: landscapes of all gaits, convergence of all optimizers, one report.

`hexctl.study(folder="report")` runs them, the modules here are its parts.

Its parameters: `help(hexctl.study.__call__)`.
"""

from hexctl.callable_package import make_callable

make_callable(__name__, "study")
