"""Parameters of the node: answers of the six services, and what is refused with which reason."""

import random
from dataclasses import fields
from typing import Any

import pytest
from mcap_ros2._dynamic import generate_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hexctl.errors import MessageError
from hexctl.options import options_of
from hexctl.robot.loader import load_robot
from hexctl.server.ros.settings import LiveSettings, RosSettings, content
from hexctl.server.serve_options import ServeOptions
from hexctl.teleop.drive_options import DriveOptions
from hexctl.wire import ros_cdr
from hexctl.wire.ros import parameters
from hexctl.wire.ros.parameters import DEFINITIONS, ParameterService, ParameterType, request_and_answer
from tests.server.bench import spoiled

NAMES = ["gait", "level", "ros_drive", "sit_after", "use_sim_time"]
SET, ATOMICALLY = ParameterService.SET, ParameterService.SET_ATOMICALLY


@pytest.fixture
def live() -> LiveSettings:
    return LiveSettings(load_robot("ant"), RosSettings(ros_drive=True, sit_after_s=20.0))


def referee(text: str) -> Any:
    """Decoder of a definition, by mcap-ros2-support, with the definitions of ROS 2 Jazzy."""
    store, name = get_typestore(Stores.ROS2_JAZZY), "a/msg/Answer"
    store.register(get_types_from_msg(text, name))
    return generate_dynamic(name, str(store.generate_msgdef(name, ros_version=2)[0]))[name]


def decoded_answer(service: ParameterService, answer: bytes) -> Any:
    """Content of an answer, decoded by the referee."""
    definition = DEFINITIONS[service][1]
    return getattr(referee(definition)(answer), definition.rpartition(" ")[2])


def ask(live: LiveSettings, service: ParameterService, payload: bytes) -> Any:
    """Content of the answer to a request."""
    asked = parameters.decode_request(service, payload)
    return decoded_answer(service, parameters.encode_answer(service, content(live, service, asked)))


def request(service: ParameterService, **content: Any) -> bytes:
    """Request in CDR, as a ROS client encodes it."""
    return ros_cdr.encode(ros_cdr.make(request_and_answer(service)[0], **content))


def named(*names: str) -> dict[str, Any]:
    return {"names": list(names)}


def wishes(**values: Any) -> dict[str, Any]:
    """Parameters to set; None is a value that is not set."""
    made = []
    for name, value in values.items():
        message = parameters.value_message(False if value is None else value)
        message.type = 0 if value is None else message.type
        made.append(ros_cdr.make("rcl_interfaces/msg/Parameter", name=name, value=message))
    return {"parameters": made}


def test_settings_are_listed_read_and_described(live: LiveSettings) -> None:
    listed = ask(live, ParameterService.LIST, request(ParameterService.LIST, prefixes=[], depth=0))
    assert list(listed.names) == NAMES
    some = request(ParameterService.LIST, prefixes=["gait", "legs"], depth=1)
    assert list(ask(live, ParameterService.LIST, some).names) == ["gait"]
    values = ask(live, ParameterService.GET, request(ParameterService.GET, **named("sit_after", "gait")))
    assert [(one.type, one.double_value, one.string_value) for one in values] == [
        (3, 20.0, ""),
        (4, 0.0, "tripod"),
    ]
    types = ask(live, ParameterService.GET_TYPES, request(ParameterService.GET_TYPES, **named(*NAMES)))
    assert list(types) == [4, 1, 1, 3, 1]
    described = ask(live, ParameterService.DESCRIBE, request(ParameterService.DESCRIBE, **named(*NAMES)))
    assert [one.read_only for one in described] == [False, False, True, False, True]
    (allowed,) = described[3].floating_point_range
    assert (allowed.from_value, allowed.to_value, allowed.step) == (1.0, 3600.0, 0.0)
    assert "1..3600" in described[3].description


@pytest.mark.parametrize("name", ["get_parameters", "get_parameter_types", "describe_parameters"])
def test_an_unknown_name_empties_the_list_as_in_rclcpp_and_rclpy(live: LiveSettings, name: str) -> None:
    service = ParameterService(name)
    assert len(ask(live, service, request(service, **named("gait", "speed")))) == 0


def test_ranges_are_those_of_the_command_line() -> None:
    of = {one.name: one for spec in (ServeOptions, DriveOptions) for one in options_of(spec)}
    for one in options_of(RosSettings):
        if one.range is not None or one.name == "gait":
            typed = of[one.name]
            assert (one.flag, one.range, one.typed.parse) == (typed.flag, typed.range, typed.typed.parse)
            assert one.default == typed.default
    assert {field.name for field in fields(RosSettings)} - {"use_sim_time"} <= of.keys()


def test_values_are_set(live: LiveSettings) -> None:
    results = ask(live, SET, request(SET, **wishes(sit_after=30.0, gait="5,1,2,4,3,6", level=True)))
    assert [(one.successful, one.reason) for one in results] == 3 * [(True, "")]
    assert (live.now.sit_after_s, live.now.gait, live.now.level) == (30.0, "5,1,2,4,3,6", True)
    assert ask(live, ATOMICALLY, request(ATOMICALLY, **wishes(gait=" Wave ", sit_after=1.0))).successful
    assert (live.now.sit_after_s, live.now.gait) == (1.0, "wave")


REFUSED = [
    ("speed", 1.0, "was not declared; allowed: gait"),
    ("use_sim_time", True, "read-only"),
    ("sit_after", 30, r"of type {double}, setting it to {integer} is not allowed. Write a point"),
    ("sit_after", None, r"setting it to {not set}"),
    ("sit_after", 0.5, "sit_after: got 0.5; allowed: 1 to 3600 s"),
    ("sit_after", float("nan"), "sit_after: got nan"),
    ("gait", "gallop", "gait: got 'gallop'; allowed: demo, tripod"),
    ("gait", "", "gait"),
]


@pytest.mark.parametrize(("name", "value", "reason"), REFUSED)
def test_anything_else_is_refused_with_a_reason(
    live: LiveSettings, name: str, value: Any, reason: str
) -> None:
    before = live.now
    (result,) = ask(live, SET, request(SET, **wishes(**{name: value})))
    assert not result.successful
    assert reason in result.reason
    refused = wishes(sit_after=40.0)["parameters"] + wishes(**{name: value})["parameters"]
    assert not ask(live, ATOMICALLY, request(ATOMICALLY, parameters=refused)).successful
    assert live.now is before, "all or nothing"


def test_an_array_is_refused_by_its_type(live: LiveSettings) -> None:
    for code, words in ((8, "double_array"), (77, "unknown type 77")):
        wish = wishes(sit_after=2.0)
        wish["parameters"][0].value.type = code
        (result,) = ask(live, SET, request(SET, **wish))
        assert f"setting it to {{{words}}}" in result.reason


def test_without_drive_all_is_read_only() -> None:
    live = LiveSettings(load_robot("ant"), RosSettings())
    (result,) = ask(live, SET, request(SET, **wishes(sit_after=30.0)))
    assert "read-only" in result.reason
    assert "--ros-drive" in result.reason
    assert all(descriptor.read_only for descriptor in map(live.descriptor, NAMES))


@pytest.mark.parametrize("service", ParameterService)
def test_spoiled_requests_are_refused_or_answered(live: LiveSettings, service: ParameterService) -> None:
    chance = random.Random(service.value)
    setting = service in (SET, ATOMICALLY)
    good = request(
        service,
        **(
            wishes(sit_after=30.0, gait="wave")
            if setting
            else {"prefixes": ["gait"], "depth": 0}
            if service is ParameterService.LIST
            else named(*NAMES)
        ),
    )
    refused = 0
    for _ in range(500):
        try:
            asked = parameters.decode_request(service, spoiled(good, chance))
        except MessageError:
            refused += 1
        else:
            parameters.encode_answer(service, content(live, service, asked))
    assert refused > 50
    assert 1 <= live.now.sit_after_s <= 3600


def test_types_are_those_of_rcl_interfaces() -> None:
    text = get_typestore(Stores.ROS2_JAZZY).fielddefs["rcl_interfaces/msg/ParameterType"][0]
    codes = {name.removeprefix("PARAMETER_"): value for name, _, value in text}
    assert codes == {one.name: int(one) for one in ParameterType}
