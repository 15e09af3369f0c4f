"""A leg fails in mid-walk and the robot walks on without it: `hexctl.demo()`.

Its parameters: `help(hexctl.demo.__call__)`.
"""

from hexctl.callable_package import make_callable

make_callable(__name__, "rescue")
