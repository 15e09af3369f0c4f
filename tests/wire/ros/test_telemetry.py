"""ROS: messages read by a decoder of others, names and attachments of rmw_zenoh, and allowed routers."""

import socket
from typing import Any

import numpy as np
import pytest
import zenoh.ext
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hexctl.errors import InputError, MessageError
from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.links import Endpoint
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.motion_commands import TWIST, TWIST_STAMPED
from hexctl.wire.ros.parameters import DEFINITIONS, ParameterService, request_and_answer
from hexctl.wire.ros.ros_names import SERVICE_HASHES, Kind, Qos, RosEndpoint, RosNode, type_hash
from hexctl.wire.ros.ros_session import (
    GREETING_S,
    SIZE,
    Attachment,
    RosService,
    RouterWatch,
    check_router,
    open_ros_session,
)
from hexctl.wire.ros.telemetry import DiagnosticStatus, Level
from tests.wire.ros.decoding import decoded

STAMP_NS = 1_700_000_001_000_000_002


def test_transforms_have_all_one_stamp() -> None:
    frames = [("odom", "base_link"), ("base_link", "a"), ("a", "tip")]
    numbers = np.random.default_rng(1).normal(size=21)
    message = decoded(telemetry.TRANSFORMS, telemetry.transforms(frames).encode(STAMP_NS, numbers))
    got = message.transforms
    assert [(one.header.frame_id, one.child_frame_id) for one in got] == frames
    assert {(one.header.stamp.sec, one.header.stamp.nanosec) for one in got} == {(1_700_000_001, 2)}
    for one, row in zip(got, numbers.reshape(3, 7), strict=True):
        place, turned = one.transform.translation, one.transform.rotation
        assert [place.x, place.y, place.z, turned.x, turned.y, turned.z, turned.w] == row.tolist()


def test_what_an_imu_does_not_measure_is_marked() -> None:
    quaternion, rate_rad_s = np.array([0.9, 0.1, 0.2, 0.3]), np.array([0.4, 0.5, 0.6])
    for known in ((quaternion, None), (None, rate_rad_s), (quaternion, rate_rad_s)):
        message = decoded(ros_cdr.IMU, telemetry.encode_imu(STAMP_NS, *known))
        turn, rate = message.orientation, message.angular_velocity
        told = [turn.w, turn.x, turn.y, turn.z], [rate.x, rate.y, rate.z]
        for values, said, covariance in zip(
            known,
            told,
            (message.orientation_covariance, message.angular_velocity_covariance),
            strict=True,
        ):
            assert list(covariance) == [-1.0 if values is None else 0.0] + 8 * [0.0]
            assert values is None or said == values.tolist()
        assert message.linear_acceleration_covariance[0] == -1


def test_diagnostics() -> None:
    found = [DiagnosticStatus(Level.WARN, "hexctl: robot", "warm", {"battery (V)": "11.1"})]
    payload = telemetry.encode_diagnostics(found, "ant", STAMP_NS)
    (status,) = decoded(telemetry.DIAGNOSTICS, payload).status
    assert (status.level, status.name, status.message, status.hardware_id) == (
        1,
        "hexctl: robot",
        "warm",
        "ant",
    )
    assert [(one.key, one.value) for one in status.values] == [("battery (V)", "11.1")]


def test_an_answer_of_a_trigger() -> None:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg("bool success\nstring message", "a/msg/Answer"))
    for success, text in ((True, ""), (False, "stopped: estop"), (True, "é")):
        message = store.types["a/msg/Answer"](success, text)
        payload = telemetry.encode_trigger_answer(success, text)
        assert payload == bytes(store.serialize_cdr(message, "a/msg/Answer"))


def twist(kind: str, velocity: FloatArray) -> bytes:
    """A velocity as a message of a type."""
    forward, left, turn = velocity.tolist()
    message = ros_cdr.make(
        TWIST,
        linear=ros_cdr.make("geometry_msgs/msg/Vector3", x=forward, y=left, z=7.0),
        angular=ros_cdr.make("geometry_msgs/msg/Vector3", x=7.0, y=7.0, z=turn),
    )
    if kind == TWIST_STAMPED:
        message = ros_cdr.make(TWIST_STAMPED, header=ros_cdr.header(0, "base_link"), twist=message)
    return ros_cdr.encode(message)


STRING_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
STRING_OF = f"std_msgs::msg::dds_::String_/{STRING_HASH}"
ADD_HASH = "RIHS01_e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a"


def chatter(node: RosNode, kind: Kind = Kind.PUBLISHER, depth: int = 7) -> RosEndpoint:
    return RosEndpoint(node, kind, "chatter", "std_msgs/msg/String", 10, Qos(depth))


def test_a_topics_key_is_that_of_the_design_document() -> None:
    assert chatter(RosNode()).key == f"0/chatter/{STRING_OF}"
    within = chatter(RosNode(namespace="robot1"))
    assert within.key == f"0/robot1/chatter/{STRING_OF}"


def test_tokens_are_those_of_the_design_document() -> None:
    node = RosNode(name="listener", domain=2)
    assert node.token("aac3178e") == "@ros2_lv/2/aac3178e/0/0/NN/%/%/listener"
    assert chatter(node, Kind.SUBSCRIPTION, 10).token("aac3178e") == (
        f"@ros2_lv/2/aac3178e/0/10/MS/%/%/listener/%chatter/{STRING_OF}/::,10:,:,:,,"
    )
    mangled = chatter(RosNode(namespace="/lab/ant/")).token("1")
    assert "/MP/%/%lab%ant/hexctl/%lab%ant%chatter/" in mangled
    talker = RosNode(name="talker", domain=2)
    assert chatter(talker).token("8b20").endswith(f"/10/MP/%/%/talker/%chatter/{STRING_OF}/::,7:,:,:,,")


def test_topics_resolve_as_in_ros() -> None:
    node = RosNode(namespace="lab")
    assert node.resolved("odom") == "/lab/odom"
    assert node.resolved("/diagnostics") == "/diagnostics"
    assert node.resolved("~/estop") == "/lab/hexctl/estop"
    assert RosNode().resolved("~/estop") == "/hexctl/estop"


def test_humble_has_a_word_in_place_of_the_hash() -> None:
    endpoint = chatter(RosNode(humble=True))
    assert endpoint.key == "0/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported"
    assert "/TypeHashNotSupported/" in endpoint.token("1")


def service_hash(name: str, request: Any, answer: Any) -> str:
    """Hash of a service by its description: two messages and an event (rosidl's ServiceEventInfo)."""
    store = get_typestore(Stores.ROS2_JAZZY)
    base, named, sequence, array = Nodetype.BASE, Nodetype.NAME, Nodetype.SEQUENCE, Nodetype.ARRAY
    info = [
        ("event_type", (base, ("uint8", 0))),
        ("stamp", (named, "builtin_interfaces/msg/Time")),
        ("client_gid", (array, ((base, ("uint8", 0)), 16))),
        ("sequence_number", (base, ("int64", 0))),
    ]
    event: list[Any] = [("info", (named, "service_msgs/msg/ServiceEventInfo"))]
    event += [(end, (sequence, ((named, f"{name}_{end.title()}"), 1))) for end in ("request", "response")]
    ends = ("request", "response", "event")
    whole = [(f"{end}_message", (named, f"{name}_{end.title()}")) for end in ends]
    fields: dict[str, Any] = {
        "service_msgs/msg/ServiceEventInfo": info,
        f"{name}_Request": request,
        f"{name}_Response": answer,
        f"{name}_Event": event,
        name: whole,
    }
    store.fielddefs.update({kind: ([], each) for kind, each in fields.items()})
    return store.hash_rihs01(name)


def test_hashes_of_services_follow_from_their_descriptions() -> None:
    number, flag, text = ((Nodetype.BASE, (kind, 0)) for kind in ("int64", "bool", "string"))
    add = service_hash("example_interfaces/srv/AddTwoInts", [("a", number), ("b", number)], [("sum", number)])
    assert add == ADD_HASH  # the description is right: this one stands in the design document
    trigger = service_hash("std_srvs/srv/Trigger", [], [("success", flag), ("message", text)])
    assert SERVICE_HASHES["std_srvs/srv/Trigger"] == trigger


@pytest.mark.parametrize("service", ParameterService)
def test_hashes_of_parameter_services_follow_from_their_definitions(service: ParameterService) -> None:
    ends = request_and_answer(service)
    types: dict[str, Any] = {}
    for name, definition in zip(ends, DEFINITIONS[service], strict=True):
        types |= get_types_from_msg(definition, name)
    request, answer = (types[name][1] for name in ends)
    assert SERVICE_HASHES[service.kind] == service_hash(service.kind, request, answer)


def test_hashes_are_those_of_later_distributions_too() -> None:
    assert type_hash("std_msgs/msg/String") == STRING_HASH
    for store in (Stores.ROS2_JAZZY, Stores.LATEST):
        hashes = get_typestore(store)
        for kind in ("sensor_msgs/msg/JointState", "nav_msgs/msg/Odometry", "geometry_msgs/msg/TwistStamped"):
            assert type_hash(kind) == hashes.hash_rihs01(kind)


def test_a_namespace_or_a_domain_that_ros_would_refuse_is_refused() -> None:
    for namespace in ("a//b", "1st", "lab ant", "a/%", "a*", "@ros2_lv"):
        with pytest.raises(InputError, match="ros_namespace"):
            RosNode(namespace=namespace)
    for domain in (-1, 233):
        with pytest.raises(InputError, match="ros_domain"):
            RosNode(domain=domain)


GID = bytes(range(16))
ONE = Attachment(1, 1_700_000_000_000_000_002, GID)


def test_an_attachment_is_what_rmw_zenoh_serializes() -> None:
    given = (zenoh.ext.Int64(ONE.sequence), zenoh.ext.Int64(ONE.stamp_ns), GID)
    kind: Any = tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes]
    assert len(ONE.packed()) == SIZE == 33
    assert bytes(zenoh.ext.z_serialize(given)) == ONE.packed()
    assert zenoh.ext.z_deserialize(kind, zenoh.ZBytes(ONE.packed())) == given
    assert Attachment.unpacked(ONE.packed()) == ONE


@pytest.mark.parametrize(
    "data", [b"", ONE.packed()[:-1], ONE.packed() + b"\0", ONE.packed()[:16] + bytes(17)]
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError, match="33"):
        Attachment.unpacked(data)


def test_routers_are_on_tcp_and_beyond_this_computer_only_deliberately() -> None:
    for text in ("tls/localhost:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "localhost:7447"):
        with pytest.raises(InputError, match="ros"):
            check_router(text, insecure=True)
    with pytest.raises(InputError):
        check_router("tcp/192.168.1.5:7447", insecure=False)
    assert check_router("tcp/192.168.1.5:7447", insecure=True).port == 7447
    assert check_router("tcp/localhost:7447", insecure=False).is_loopback


def test_a_router_that_is_not_there_and_one_that_is_none_are_told_apart() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        endpoint = Endpoint.parse(f"tcp/127.0.0.1:{other.getsockname()[1]}")
        watch = RouterWatch(endpoint)
        assert watch.trouble(False, 10.0) is None, "it may be a router that has just begun to listen"
        assert "is no ROS router" in str(watch.trouble(False, 10.0 + GREETING_S))
    assert "yet" in str(watch.trouble(False, 30.0))
    assert watch.trouble(True, 40.0) is None
    assert "any more" in str(watch.trouble(False, 50.0))


def test_a_service_is_complete_as_ros_clients_ask_for_and_answers_under_their_number() -> None:
    """rmw_zenoh asks complete services only, so that another one seems not to be there."""
    server = RosEndpoint(RosNode(), Kind.SERVICE, "~/estop", "std_srvs/srv/Trigger", 5)
    with open_ros_session(Endpoint.parse("tcp/127.0.0.1:1")) as session:
        service = RosService(session, server)
        for attachment in (b"", ONE.packed()):
            replies = session.get(
                server.key, payload=b"why", target=zenoh.QueryTarget.ALL_COMPLETE, attachment=attachment
            )
            request = service.next_request()
            assert (request is None) == (service.take_malformed() == 1) == (not attachment)
        assert request is not None
        assert request.payload == b"why"
        request.answer(b"done")
        (reply,) = replies
        assert reply.ok is not None
        got = Attachment.unpacked(bytes(reply.ok.attachment or b""))
        assert (bytes(reply.ok.payload), got.sequence, got.gid) == (b"done", ONE.sequence, ONE.gid)
