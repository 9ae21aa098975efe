"""Messages and services as ROS 2 has them, for Eclipse Cyclone DDS: names, types and order of the fields.

Source: common_interfaces, geometry2 and rcl_interfaces (Humble and later). A request or a reply of a service
begins with the header of rmw_cyclonedds.
"""

from dataclasses import dataclass

from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, byte, float64, int8, int32, int64, sequence, uint8, uint32, uint64


def msg(package: str, name: str) -> str:
    return f"{package}.msg.dds_.{name}_"


@dataclass
class Time(IdlStruct, typename=msg("builtin_interfaces", "Time")):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename=msg("std_msgs", "Header")):
    stamp: Time
    frame_id: str


@dataclass
class JointState(IdlStruct, typename=msg("sensor_msgs", "JointState")):
    header: Header
    name: sequence[str]
    position: sequence[float64]
    velocity: sequence[float64]
    effort: sequence[float64]


@dataclass
class Vector3(IdlStruct, typename=msg("geometry_msgs", "Vector3")):
    x: float64
    y: float64
    z: float64


@dataclass
class Point(IdlStruct, typename=msg("geometry_msgs", "Point")):
    x: float64
    y: float64
    z: float64


@dataclass
class Quaternion(IdlStruct, typename=msg("geometry_msgs", "Quaternion")):
    x: float64
    y: float64
    z: float64
    w: float64


@dataclass
class Transform(IdlStruct, typename=msg("geometry_msgs", "Transform")):
    translation: Vector3
    rotation: Quaternion


@dataclass
class TransformStamped(IdlStruct, typename=msg("geometry_msgs", "TransformStamped")):
    header: Header
    child_frame_id: str
    transform: Transform


@dataclass
class TFMessage(IdlStruct, typename=msg("tf2_msgs", "TFMessage")):
    transforms: sequence[TransformStamped]


@dataclass
class Wrench(IdlStruct, typename=msg("geometry_msgs", "Wrench")):
    force: Vector3
    torque: Vector3


@dataclass
class WrenchStamped(IdlStruct, typename=msg("geometry_msgs", "WrenchStamped")):
    header: Header
    wrench: Wrench


@dataclass
class KeyValue(IdlStruct, typename=msg("diagnostic_msgs", "KeyValue")):
    key: str
    value: str


@dataclass
class DiagnosticStatus(IdlStruct, typename=msg("diagnostic_msgs", "DiagnosticStatus")):
    level: byte
    name: str
    message: str
    hardware_id: str
    values: sequence[KeyValue]


@dataclass
class DiagnosticArray(IdlStruct, typename=msg("diagnostic_msgs", "DiagnosticArray")):
    header: Header
    status: sequence[DiagnosticStatus]


@dataclass
class CompressedImage(IdlStruct, typename=msg("sensor_msgs", "CompressedImage")):
    header: Header
    format: str
    data: sequence[uint8]


@dataclass
class NodeEntities(IdlStruct, typename=msg("rmw_dds_common", "NodeEntitiesInfo")):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[array[uint8, 16]]
    writer_gid_seq: sequence[array[uint8, 16]]


@dataclass
class ParticipantEntities(IdlStruct, typename=msg("rmw_dds_common", "ParticipantEntitiesInfo")):
    gid: array[uint8, 16]
    node_entities_info_seq: sequence[NodeEntities]


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Request_"):
    guid: uint64
    seq: int64
    structure_needs_at_least_one_member: uint8 = 0


@dataclass
class TriggerReply(IdlStruct, typename="std_srvs.srv.dds_.Trigger_Response_"):
    guid: uint64
    seq: int64
    success: bool
    message: str


@dataclass
class MoveToRequest(IdlStruct, typename="mcdpr_msgs.srv.dds_.MoveTo_Request_"):
    guid: uint64
    seq: int64
    target: Point
    speed_mps: float64


@dataclass
class MoveToReply(IdlStruct, typename="mcdpr_msgs.srv.dds_.MoveTo_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    message: str
    duration_s: float64


@dataclass
class RunTaskRequest(IdlStruct, typename="mcdpr_msgs.srv.dds_.RunTask_Request_"):
    guid: uint64
    seq: int64
    task: str


@dataclass
class RunTaskReply(IdlStruct, typename="mcdpr_msgs.srv.dds_.RunTask_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    message: str
    duration_s: float64


# Actions: three services and two topics each. Identities are unique_identifier_msgs/UUID.
@dataclass
class UUID(IdlStruct, typename=msg("unique_identifier_msgs", "UUID")):
    uuid: array[uint8, 16]


@dataclass
class GoalInfo(IdlStruct, typename=msg("action_msgs", "GoalInfo")):
    goal_id: UUID
    stamp: Time


@dataclass
class GoalStatus(IdlStruct, typename=msg("action_msgs", "GoalStatus")):
    goal_info: GoalInfo
    status: int8


@dataclass
class GoalStatusArray(IdlStruct, typename=msg("action_msgs", "GoalStatusArray")):
    status_list: sequence[GoalStatus]


@dataclass
class MoveToSendGoalRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.MoveTo_SendGoal_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID
    target: Point
    speed_mps: float64


@dataclass
class MoveToSendGoalReply(IdlStruct, typename="mcdpr_msgs.action.dds_.MoveTo_SendGoal_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    stamp: Time


@dataclass
class RunTaskSendGoalRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.RunTask_SendGoal_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID
    task: str


@dataclass
class RunTaskSendGoalReply(IdlStruct, typename="mcdpr_msgs.action.dds_.RunTask_SendGoal_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    stamp: Time


@dataclass
class MoveToGetResultRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.MoveTo_GetResult_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID


@dataclass
class MoveToGetResultReply(IdlStruct, typename="mcdpr_msgs.action.dds_.MoveTo_GetResult_Response_"):
    guid: uint64
    seq: int64
    status: int8
    reached: bool
    message: str


@dataclass
class RunTaskGetResultRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.RunTask_GetResult_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID


@dataclass
class RunTaskGetResultReply(IdlStruct, typename="mcdpr_msgs.action.dds_.RunTask_GetResult_Response_"):
    guid: uint64
    seq: int64
    status: int8
    reached: bool
    message: str


@dataclass
class CancelGoalRequest(IdlStruct, typename="action_msgs.srv.dds_.CancelGoal_Request_"):
    guid: uint64
    seq: int64
    goal_info: GoalInfo


@dataclass
class CancelGoalReply(IdlStruct, typename="action_msgs.srv.dds_.CancelGoal_Response_"):
    guid: uint64
    seq: int64
    return_code: int8
    goals_canceling: sequence[GoalInfo]


@dataclass
class MoveToFeedback(IdlStruct, typename="mcdpr_msgs.action.dds_.MoveTo_FeedbackMessage_"):
    goal_id: UUID
    path_s: float64
    duration_s: float64


@dataclass
class RunTaskFeedback(IdlStruct, typename="mcdpr_msgs.action.dds_.RunTask_FeedbackMessage_"):
    goal_id: UUID
    path_s: float64
    duration_s: float64


@dataclass
class CalibrateSendGoalRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.Calibrate_SendGoal_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID
    poses: uint32


@dataclass
class CalibrateSendGoalReply(IdlStruct, typename="mcdpr_msgs.action.dds_.Calibrate_SendGoal_Response_"):
    guid: uint64
    seq: int64
    accepted: bool
    stamp: Time


@dataclass
class CalibrateGetResultRequest(IdlStruct, typename="mcdpr_msgs.action.dds_.Calibrate_GetResult_Request_"):
    guid: uint64
    seq: int64
    goal_id: UUID


@dataclass
class CalibrateGetResultReply(IdlStruct, typename="mcdpr_msgs.action.dds_.Calibrate_GetResult_Response_"):
    guid: uint64
    seq: int64
    status: int8
    reached: bool
    message: str


@dataclass
class CalibrateFeedback(IdlStruct, typename="mcdpr_msgs.action.dds_.Calibrate_FeedbackMessage_"):
    goal_id: UUID
    done: float64
    wanted: float64
