"""Answers `ros2 param`, launch files and rqt: the six parameter services of the node."""

from typing import Any

import numpy as np
import zenoh

from hexctl.errors import MessageError
from hexctl.server.ros.settings import LiveSettings
from hexctl.wire.ros import parameters
from hexctl.wire.ros.endpoints import RosRequest, RosService
from hexctl.wire.ros.parameters import ParameterService, ParameterType
from hexctl.wire.ros.ros_names import Kind, Qos, RosEndpoint, RosNode

#: Number of the first endpoint of the node.
FIRST = 50

#: That of parameters in every node (rmw_qos_profile_parameters).
QOS = Qos(depth=1000)


class ParameterServices:
    """The services on an open session."""

    def __init__(self, session: zenoh.Session, node: RosNode, live: LiveSettings) -> None:
        self._live = live
        self._services = {
            service: RosService(session, parameter_endpoint(node, service)) for service in ParameterService
        }

    def answer(self) -> int:
        """Answer a request of each service; return the number of malformed ones, which get no answer."""
        malformed = 0
        for service, server in self._services.items():
            request = server.next_request()
            malformed += server.take_malformed()
            if request is not None:
                malformed += not self._answered(service, request)
        return malformed

    def _answered(self, service: ParameterService, request: RosRequest) -> bool:
        try:
            asked = parameters.decode_request(service, request.payload)
        except MessageError:
            request.refuse()
            return False
        request.answer(parameters.encode_answer(service, content(self._live, service, asked)))
        return True


def parameter_endpoint(node: RosNode, service: ParameterService) -> RosEndpoint:
    """Endpoint of a parameter service."""
    number = FIRST + list(ParameterService).index(service)
    return RosEndpoint(node, Kind.SERVICE, f"~/{service.value}", service.kind, number, QOS)


def content(live: LiveSettings, service: ParameterService, asked: Any) -> Any:
    """Content of an answer. As in rclcpp and rclpy, one unknown name empties the whole list."""
    if service is ParameterService.SET:
        return [parameters.result_message(live.set([wish])) for wish in asked.parameters]
    if service is ParameterService.SET_ATOMICALLY:
        return parameters.result_message(live.set(asked.parameters))
    if service is ParameterService.LIST:
        return parameters.names_message(live.names(asked.prefixes))
    read = live.descriptor if service is ParameterService.DESCRIBE else live.value
    found: list[Any] = [read(name) for name in asked.names]
    found = [] if None in found else found
    if service is ParameterService.GET:
        return [parameters.value_message(value) for value in found]
    if service is ParameterService.GET_TYPES:
        return np.array([ParameterType.of(value) for value in found], dtype=np.uint8)
    return found
