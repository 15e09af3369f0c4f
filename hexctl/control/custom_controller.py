"""Custom controllers: a `Controller`, a factory of one, or a plain function of step and state."""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hexctl.control.controllers import Controller
from hexctl.control.preparation import WalkStart
from hexctl.errors import check_type
from hexctl.types import FloatArray, RobotState, as_joint_angles

#: 18 joint angles in rad for a step and the robot's state.
StepFunction = Callable[[int, RobotState], ArrayLike]

#: Makes the controller of a walk once the robot stands: also a class that takes a `WalkStart`.
MakeController = Callable[[WalkStart], Controller | StepFunction]

#: Custom controllers of a batch, which are made per walk, and of one robot.
BatchController = MakeController | StepFunction
CustomController = Controller | BatchController

#: Allowed custom controllers, for messages.
CONTROLLERS = (
    "a Controller, or a function or class that makes one of a WalkStart, "
    "or a function of step and state that returns 18 joint angles"
)


class FunctionController(Controller):
    """Walks by a function of step and state that returns 18 joint angles in rad; in a batch also (n, 18)."""

    def __init__(self, function: StepFunction, batch_shape: tuple[int, ...] = ()) -> None:
        self._function, self._batch_shape = function, batch_shape

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """The result of the function, leading shape + (18,)."""
        angles_rad = as_joint_angles(self._function(step, state), "controller")
        if angles_rad.ndim == 1 and self._batch_shape:
            return np.tile(angles_rad, (*self._batch_shape, 1))
        return angles_rad


def check_controller(controller: object) -> None:
    """Raise WrongTypeError for anything but a custom controller or None."""
    if not isinstance(controller, Controller | None) and _argument_count(controller) is None:
        check_type(controller, Controller, "controller", CONTROLLERS)


def made_controller(controller: CustomController, start: WalkStart) -> Controller:
    """A controller, one made by a factory, or a function as a controller; raises WrongTypeError."""
    made: Any = controller
    if not isinstance(made, Controller) and _argument_count(made) == 1:
        made = made(start)
    if not isinstance(made, Controller) and _argument_count(made) == 2:
        made = FunctionController(made, start.batch_shape)
    check_type(made, Controller, "controller", CONTROLLERS)
    assert isinstance(made, Controller)  # noqa: S101  checked
    return made


def controller_name(controller: object) -> str | None:
    """Name of a custom controller's function or class, for results; None for the functions of hexctl.

    An attribute `controller_name` is another name.
    """
    if controller is None or isinstance(name := getattr(controller, "controller_name", None), str):
        return None if controller is None else name
    if isinstance(controller, partial):
        return controller_name(controller.func)
    if isinstance(controller, type) or not hasattr(controller, "__name__"):
        return (controller if isinstance(controller, type) else type(controller)).__name__
    own = str(getattr(controller, "__module__", "")).startswith("hexctl.")
    return None if own else str(controller.__name__).strip("<>")


def _argument_count(function: object) -> int | None:
    """Positional arguments of a function, 1 or 2, or None; 1 if both fit or the signature is unknown."""
    if not callable(function):
        return None
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return 1
    return next((count for count in (1, 2) if _fits(signature, count)), None)


def _fits(signature: inspect.Signature, count: int) -> bool:
    try:
        signature.bind(*range(count))
    except TypeError:
        return False
    return True
