"""Finding a gait for a failed leg with `hexctl.adapt(failed_leg=5)`; see `help(hexctl.adapt.__call__)`."""

from hexctl.lazy_names import make_callable

make_callable(__name__, "adaptation")
