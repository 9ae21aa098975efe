"""`mcdpr ros` as ROS 2 sees it, by a foreign implementation of DDS: what is published fits the robot, orders are
obeyed, and what cannot be done is refused in words. Nothing here is of the program's own code but the program."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import messages as m
import pytest
from conftest import DEADLINE_S, DOMAIN, KEPT, PROGRAM, Ros, serving, values
from cyclonedds.builtin import BuiltinDataReader, BuiltinTopicDcpsPublication
from cyclonedds.core import Policy

# Home of the built-in robot, m, and a place near it.
HOME = (0.255, -0.105, -0.180)
PLACE = (0.265, -0.105, -0.170)
# A stop that comes by ROS is obeyed within this, s.
STOP_S = 0.1


def statics(x_m: float, y_m: float, z_m: float) -> Any:
    """How the robot of the file hangs with its platform there."""
    words = [PROGRAM, "--json", "statics", *(f"{value * 1e3:.6f}" for value in (x_m, y_m, z_m))]
    return json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)


def near(a: float, b: float, within: float) -> bool:
    return abs(a - b) <= within


def test_what_is_published_fits_the_robot(ros: Ros) -> None:
    ros.state("Disarmed")
    accepted = ros.move_to(*PLACE)
    assert accepted.accepted and accepted.message == "" and accepted.duration_s > 0.0, accepted
    ros.state("Moving")
    ros.state("Holding", task="")
    # It is there already.
    again = ros.move_to(*PLACE)
    assert again.accepted and again.duration_s == 0.0, again
    joints = ros.subscribe("rt/joint_states", m.JointState)
    platform = ros.wait(ros.subscribe("rt/tf", m.TFMessage)).transforms[0].transform.translation
    wanted = statics(platform.x, platform.y, platform.z)
    seen = ros.wait(joints, lambda sample: len(sample.velocity) == 4)
    assert seen.name == [f"winch_{cable}" for cable in range(1, 5)]
    assert seen.header.stamp.sec == pytest.approx(time.time(), abs=DEADLINE_S)
    # The machine differs from its file: anchors by 0.3 mm, tensions by the friction of pulleys.
    for length, planned in zip(seen.position, wanted["lengths_m"], strict=True):
        assert near(length, planned, 0.005), (seen.position, wanted)
    for tension, planned in zip(seen.effort, wanted["tensions_n"], strict=True):
        assert near(tension, planned, 0.2 * planned + 1.0), (seen.effort, wanted)
    assert all(abs(speed) < 0.02 for speed in seen.velocity)


def test_frames_and_wrenches_fit_each_other(ros: Ros) -> None:
    frames = ros.subscribe("rt/tf", m.TFMessage)
    places = {frame.child_frame_id: frame for frame in ros.wait(frames).transforms}
    assert set(places) == {"platform", *(f"attachment_{cable}" for cable in range(1, 5))}
    assert all(frame.header.frame_id == "world" for frame in places.values())
    # Kept for late subscribers: the tool and the camera on the platform.
    fixed = ros.wait(ros.subscribe("rt/tf_static", m.TFMessage, KEPT)).transforms
    assert {frame.child_frame_id: frame.header.frame_id for frame in fixed} == {
        "tool": "platform",
        "camera": "platform",
    }
    # The tool is where it was sent to, by the platform's attitude.
    tool = next(frame for frame in fixed if frame.child_frame_id == "tool").transform.translation
    platform = places["platform"].transform
    at = rotated(platform.rotation, (tool.x, tool.y, tool.z))
    origin = platform.translation
    for value, home in zip((origin.x + at[0], origin.y + at[1], origin.z + at[2]), PLACE, strict=True):
        assert near(value, home, 0.002), (origin, at)
    # Together the cables carry the platform, and pull it nowhere to the side.
    pulls = [ros.wait(ros.subscribe(f"rt/cables/cable_{cable}/wrench", m.WrenchStamped)) for cable in range(1, 5)]
    assert [pull.header.frame_id for pull in pulls] == [f"attachment_{cable}" for cable in range(1, 5)]
    total = [sum(getattr(pull.wrench.force, axis) for pull in pulls) for axis in "xyz"]
    carried = sum(abs(pull.wrench.force.z) for pull in pulls)
    assert total[2] > 0.9 * carried and abs(total[0]) + abs(total[1]) < 0.3 * carried, total


def rotated(q: Any, v: tuple[float, float, float]) -> tuple[float, float, float]:
    u = (q.x, q.y, q.z)
    cross = lambda a, b: (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])  # noqa: E731
    t = tuple(2 * x for x in cross(u, v))
    w = cross(u, t)
    return tuple(v[i] + q.w * t[i] + w[i] for i in range(3))  # type: ignore[return-value]


def test_types_and_profiles_are_those_of_ros(ros: Ros) -> None:
    kinds = {
        "rt/joint_states": "sensor_msgs::msg::dds_::JointState_",
        "rt/tf": "tf2_msgs::msg::dds_::TFMessage_",
        "rt/diagnostics": "diagnostic_msgs::msg::dds_::DiagnosticArray_",
        "rt/cables/cable_4/wrench": "geometry_msgs::msg::dds_::WrenchStamped_",
        "rr/mcdpr/stopReply": "std_srvs::srv::dds_::Trigger_Response_",
        "rr/mcdpr/move_toReply": "mcdpr_msgs::srv::dds_::MoveTo_Response_",
        "rr/mcdpr/move_to/_action/send_goalReply": "mcdpr_msgs::action::dds_::MoveTo_SendGoal_Response_",
        "rr/mcdpr/move_to/_action/cancel_goalReply": "action_msgs::srv::dds_::CancelGoal_Response_",
        "rr/mcdpr/run_task/_action/get_resultReply": "mcdpr_msgs::action::dds_::RunTask_GetResult_Response_",
        "rt/mcdpr/run_task/_action/feedback": "mcdpr_msgs::action::dds_::RunTask_FeedbackMessage_",
        "rt/mcdpr/move_to/_action/status": "action_msgs::msg::dds_::GoalStatusArray_",
        "rr/mcdpr/calibrate/_action/send_goalReply": "mcdpr_msgs::action::dds_::Calibrate_SendGoal_Response_",
    }
    found = BuiltinDataReader(ros.participant, BuiltinTopicDcpsPublication).read(1000)
    # Those of this test have types of the same names.
    others = {sample.topic_name: sample for sample in found if sample.participant_key != ros.participant.guid}
    for topic, kind in kinds.items():
        assert others[topic].type_name == kind
        assert isinstance(others[topic].qos[Policy.Reliability], Policy.Reliability.Reliable)
    # Six services and three actions of three each; six topics, four wrenches, two topics of each action, and the replies.
    reader = ros.subscribe("ros_discovery_info", m.ParticipantEntities, KEPT)
    info = ros.wait(reader, lambda sample: len(sample.node_entities_info_seq[0].writer_gid_seq) == 31)
    (node,) = info.node_entities_info_seq
    assert (node.node_namespace, node.node_name) == ("/", "mcdpr")
    assert len(node.reader_gid_seq) == 15


def test_a_goal_out_of_reach_is_refused_and_nothing_moves(ros: Ros) -> None:
    ros.state("Disarmed")
    before = ros.wait(ros.subscribe("rt/joint_states", m.JointState)).position
    for place, words in [
        ((3.0, 0.0, -0.2), "from the anchor of cable"),
        ((0.265, -0.105, -0.05), "a cable cannot push"),
        ((0.255, -0.105, float("nan")), "is not finite"),
    ]:
        refused = ros.move_to(*place)
        assert not refused.accepted and words in refused.message, refused
        assert refused.duration_s == 0.0
    refused = ros.move_to(*HOME, speed=-1.0)
    assert not refused.accepted and "negative or not finite" in refused.message, refused
    refused = ros.run_task("no such task")
    assert not refused.accepted and "paper:table7" in refused.message, refused
    sample = ros.state("Disarmed")
    assert values(sample)["brakes_open"] == "0b0"
    after = ros.wait(ros.subscribe("rt/joint_states", m.JointState)).position
    assert all(near(a, b, 1e-4) for a, b in zip(before, after, strict=True))


def test_hold_and_resume_and_a_stop_within_a_tenth_of_a_second(ros: Ros) -> None:
    for trigger in ("stop", "hold", "resume"):
        ros.connect(f"mcdpr/{trigger}", m.TriggerRequest, m.TriggerReply)
    refused, _ = ros.trigger("hold")
    assert not refused.success and "nothing moves" in refused.message, refused
    accepted = ros.run_task("paper:table8")
    assert accepted.accepted and accepted.duration_s > 10.0, accepted
    ros.state("Moving")
    busy = ros.move_to(*HOME)
    assert not busy.accepted and "under way" in busy.message, busy
    held, _ = ros.trigger("hold")
    assert held.success, held
    ros.state("Holding")
    resumed, _ = ros.trigger("resume")
    assert resumed.success, resumed
    ros.state("Moving")
    # The reply comes when the stop has been sent to the board.
    stopped, took_s = ros.trigger("stop")
    assert stopped.success, stopped
    print(f"a stop was on the line after {took_s * 1e3:.1f} ms at most")
    assert took_s < STOP_S
    sample = ros.state("Disarmed")
    assert values(sample)["brakes_open"] == "0b0" and values(sample)["fault"] == ""
    # It stays there.
    joints = ros.subscribe("rt/joint_states", m.JointState)
    resting = ros.wait(joints, lambda sample: sample.velocity and max(map(abs, sample.velocity)) < 1e-3)
    assert len(resting.position) == 4
    cleared, _ = ros.trigger("clear")
    assert isinstance(cleared.message, str)


def goal_id(number: int) -> Any:
    return m.UUID([number] * 16)


def status_of(ros: Ros, action: str, number: int, *wanted: int) -> None:
    """Waits until the list of goals has the goal in one of these states."""
    lists = ros.subscribe(f"rt/mcdpr/{action}/_action/status", m.GoalStatusArray, KEPT)

    def has(sample: Any) -> bool:
        goals = {bytes(goal.goal_info.goal_id.uuid): goal.status for goal in sample.status_list}
        return goals.get(bytes([number] * 16)) in wanted

    ros.wait(lists, has)


def test_an_action_has_feedback_and_a_result(ros: Ros) -> None:
    ros.state("Disarmed", "Holding", task="")
    feedback = ros.subscribe("rt/mcdpr/move_to/_action/feedback", m.MoveToFeedback)
    send = ("mcdpr/move_to/_action/send_goal", m.MoveToSendGoalRequest, m.MoveToSendGoalReply)
    ask = ("mcdpr/move_to/_action/get_result", m.MoveToGetResultRequest, m.MoveToGetResultReply)
    ros.connect(*send)
    ros.connect(*ask)
    accepted, _ = ros.call(*send, goal_id(1), m.Point(PLACE[0] + 0.02, PLACE[1], PLACE[2]), 0.01)
    assert accepted.accepted and accepted.stamp.sec == pytest.approx(time.time(), abs=DEADLINE_S)
    # Another while it is under way is not accepted.
    status_of(ros, "move_to", 1, 2)
    busy, _ = ros.call(*send, goal_id(2), m.Point(*HOME), 0.0)
    assert not busy.accepted
    seen = ros.wait(feedback, lambda sample: sample.path_s > 0.1)
    assert bytes(seen.goal_id.uuid) == bytes([1] * 16) and seen.path_s < seen.duration_s
    # The reply comes at its end.
    result, _ = ros.call(*ask, goal_id(1))
    assert (result.status, result.reached, result.message) == (4, True, ""), result
    status_of(ros, "move_to", 1, 4)
    unknown, _ = ros.call(*ask, goal_id(99))
    assert unknown.status == 0 and "no such goal" in unknown.message, unknown
    # What the planner refuses is aborted in its words, and nothing moves.
    accepted, _ = ros.call(*send, goal_id(3), m.Point(3.0, 0.0, -0.2), 0.0)
    assert accepted.accepted
    result, _ = ros.call(*ask, goal_id(3))
    assert result.status == 6 and not result.reached and "from the anchor of cable" in result.message, result
    wrong, _ = ros.call(*send, goal_id(4), m.Point(0.255, float("nan"), -0.2), 0.0)
    assert not wrong.accepted


def test_an_action_that_is_cancelled_stops_along_its_path(ros: Ros) -> None:
    ros.state("Disarmed", "Holding", task="")
    send = ("mcdpr/run_task/_action/send_goal", m.RunTaskSendGoalRequest, m.RunTaskSendGoalReply)
    ask = ("mcdpr/run_task/_action/get_result", m.RunTaskGetResultRequest, m.RunTaskGetResultReply)
    end = ("mcdpr/run_task/_action/cancel_goal", m.CancelGoalRequest, m.CancelGoalReply)
    for each in (send, ask, end):
        ros.connect(*each)
    none, _ = ros.call(*end, m.GoalInfo(goal_id(77), m.Time(0, 0)))
    assert none.return_code == 2 and not none.goals_canceling
    accepted, _ = ros.call(*send, goal_id(11), "paper:table8")
    assert accepted.accepted
    ros.state("Moving")
    cancelled, took_s = ros.call(*end, m.GoalInfo(goal_id(11), m.Time(0, 0)))
    assert cancelled.return_code == 0 and len(cancelled.goals_canceling) == 1, cancelled
    assert bytes(cancelled.goals_canceling[0].goal_id.uuid) == bytes([11] * 16)
    result, _ = ros.call(*ask, goal_id(11))
    assert (result.status, result.reached) == (5, False), result
    sample = ros.state("Disarmed")
    assert values(sample)["brakes_open"] == "0b0" and values(sample)["fault"] == ""
    over, _ = ros.call(*end, m.GoalInfo(goal_id(11), m.Time(0, 0)))
    assert over.return_code == 3, over
    assert took_s < DEADLINE_S


def test_the_robot_calibrates_itself_and_a_cancelled_calibration_writes_nothing(tmp_path: Path) -> None:
    send = ("mcdpr/calibrate/_action/send_goal", m.CalibrateSendGoalRequest, m.CalibrateSendGoalReply)
    ask = ("mcdpr/calibrate/_action/get_result", m.CalibrateGetResultRequest, m.CalibrateGetResultReply)
    end = ("mcdpr/calibrate/_action/cancel_goal", m.CancelGoalRequest, m.CancelGoalReply)
    file = tmp_path / "paper-table5.calibration.json"
    # Poses take some seconds each; the simulated robot is in a hurry here.
    with serving(tmp_path, DOMAIN + 1, "--time-scale", "8"):
        ros = Ros(DOMAIN + 1)
        for each in (send, ask, end):
            ros.connect(*each)
        few, _ = ros.call(*send, goal_id(20), 3)
        assert not few.accepted
        accepted, _ = ros.call(*send, goal_id(21), 0)
        assert accepted.accepted
        ros.state("Moving")
        cancelled, _ = ros.call(*end, m.GoalInfo(goal_id(21), m.Time(0, 0)))
        assert cancelled.return_code == 0, cancelled
        result, _ = ros.call(*ask, goal_id(21))
        assert (result.status, result.reached) == (5, False), result
        assert values(ros.state("Disarmed"))["fault"] == ""
        assert not file.exists()
        feedback = ros.subscribe("rt/mcdpr/calibrate/_action/feedback", m.CalibrateFeedback)
        accepted, _ = ros.call(*send, goal_id(22), 10)
        assert accepted.accepted
        seen = ros.wait(feedback, lambda sample: bytes(sample.goal_id.uuid) == bytes([22] * 16) and sample.done >= 2)
        assert seen.done < seen.wanted == 10, seen
        # Nothing else moves it meanwhile.
        assert "under way" in ros.move_to(*PLACE).message
        result, _ = ros.call(*ask, goal_id(22))
        assert (result.status, result.reached) == (4, True) and "predicted position error" in result.message, result
        assert json.loads(file.read_text())["robot"] == "paper-table5"
        assert values(ros.state("Disarmed"))["brakes_open"] == "0b0"


def test_pictures_have_their_lens(ros: Ros) -> None:
    picture = ros.wait(ros.subscribe("rt/camera/image/compressed", m.CompressedImage))
    assert picture.header.frame_id == "camera" and picture.format == "png"
    assert bytes(picture.data[:8]) == b"\x89PNG\r\n\x1a\n"


def test_a_ros_side_that_dies_changes_nothing_for_the_robot(ros: Ros, robot: subprocess.Popen[str]) -> None:
    accepted = ros.move_to(HOME[0] + 0.05, HOME[1], HOME[2] + 0.02, speed=0.005)
    assert accepted.accepted, accepted
    moving = ros.state("Moving")
    (child,) = children(robot.pid)
    begun = time.monotonic()
    os.kill(child, signal.SIGKILL)
    # It comes again by itself, and reports a motion that went on meanwhile.
    again = ros.wait(
        ros.subscribe("rt/diagnostics", m.DiagnosticArray),
        lambda sample: values(sample)["state"] != values(moving)["state"] or children(robot.pid) not in ([], [child]),
    )
    assert values(again)["state"] == "Moving", again
    assert values(again)["fault"] == "" and values(again)["trouble"] == "", again
    # As far as it would be without: the path's time follows the clock.
    passed = time.monotonic() - begun
    gone = float(values(again)["path_s"]) - float(values(moving)["path_s"])
    assert gone > 0.5 * passed, (gone, passed)
    assert robot.poll() is None
    ros.clients.clear()
    stopped, _ = ros.trigger("stop")
    assert stopped.success, stopped
    ros.state("Disarmed")


def children(pid: int) -> list[int]:
    with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
        direct = [int(word) for word in file.read().split()]
    # Started by another thread than the first.
    for thread in os.listdir(f"/proc/{pid}/task"):
        try:
            with open(f"/proc/{pid}/task/{thread}/children", encoding="ascii") as file:
                direct += [int(word) for word in file.read().split()]
        except FileNotFoundError:
            continue
    return sorted(set(direct))


def test_a_program_without_its_bridge_says_how_to_get_it(robot: subprocess.Popen[str]) -> None:
    words = [PROGRAM, "ros", "--bridge", "/nowhere/mcdpr-ros", "--domain", str(DOMAIN)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=DEADLINE_S)
    assert done.returncode == 1 and "cargo xtask ros --build" in done.stderr, done.stderr


def test_a_robot_behind_a_port_obeys_as_well(tmp_path: Path) -> None:
    words = [PROGRAM, "sim", "--pty", "--json"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as board:
        assert board.stdout is not None
        try:
            port = json.loads(board.stdout.readline())["port"]
            with serving(tmp_path, DOMAIN + 1, "--on", port):
                ros = Ros(DOMAIN + 1)
                ros.connect("mcdpr/stop", m.TriggerRequest, m.TriggerReply)
                accepted = ros.move_to(*PLACE, speed=0.005)
                assert accepted.accepted, accepted
                ros.state("Moving")
                stopped, took_s = ros.trigger("stop")
                assert stopped.success and took_s < STOP_S, (stopped, took_s)
                assert values(ros.state("Disarmed"))["fault"] == ""
                # A board has no camera of its own.
                send = ("mcdpr/calibrate/_action/send_goal", m.CalibrateSendGoalRequest, m.CalibrateSendGoalReply)
                ask = ("mcdpr/calibrate/_action/get_result", m.CalibrateGetResultRequest, m.CalibrateGetResultReply)
                assert ros.call(*send, goal_id(1), 10)[0].accepted
                result, _ = ros.call(*ask, goal_id(1))
                assert result.status == 6 and "--tags-from" in result.message, result
        finally:
            board.terminate()
