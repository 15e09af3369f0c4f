"""Identification: the parameters of a robot's servos from its own motions."""

from hexctl.lazy_names import make_callable

make_callable(__name__, "identification")
