"""A robot behind `mcdpr ros`, and a participant of Eclipse Cyclone DDS that sees it, on the loopback."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = os.environ.get("MCDPR_PROGRAM", str(ROOT / "target" / "release" / "mcdpr"))
# One of its own for each run: others may test on this machine.
DOMAIN = os.getpid() % 200 + 20
# No multicast: the loopback of a container may have none.
os.environ["CYCLONEDDS_URI"] = """<CycloneDDS><Domain><General>
<Interfaces><NetworkInterface address="127.0.0.1" multicast="false"/></Interfaces>
<AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"""

from cyclonedds.core import Qos, Policy, ReadCondition, SampleState, InstanceState, ViewState, WaitSet  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

import messages as m  # noqa: E402

# Longer than anything takes on a busy machine.
DEADLINE_S = 60.0
ANY = SampleState.Any | ViewState.Any | InstanceState.Any
PROFILE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepLast(10))
KEPT = PROFILE + Qos(Policy.Durability.TransientLocal)


class Ros:
    """What a program of ROS 2 does, with Cyclone DDS alone."""

    def __init__(self, domain: int) -> None:
        self.participant = DomainParticipant(domain)
        self.numbers = itertools.count(1)
        self.clients: dict[str, tuple[DataWriter, DataReader]] = {}
        self.readers: dict[str, DataReader] = {}

    def subscribe(self, name: str, kind: Any, qos: Qos = PROFILE) -> DataReader:
        if name not in self.readers:
            topic = Topic(self.participant, name, kind, qos=qos)
            self.readers[name] = DataReader(self.participant, topic, qos=qos)
        return self.readers[name]

    def wait(self, reader: DataReader, good: Callable[[Any], bool] = lambda _: True) -> Any:
        """The next sample that is good."""
        waits = WaitSet(self.participant)
        condition = ReadCondition(reader, ANY)
        waits.attach(condition)
        until = time.monotonic() + DEADLINE_S
        last = None
        while time.monotonic() < until:
            waits.wait(duration(milliseconds=200))
            for sample in reader.take(100):
                if sample.sample_info.valid_data:
                    last = sample
                    if good(sample):
                        return sample
        raise AssertionError(f"nothing good came, last was {last}")

    def state(self, *wanted: str, **others: str) -> Any:
        """The next diagnostics in one of these states of the board, and with these values."""
        reader = self.subscribe("rt/diagnostics", m.DiagnosticArray)
        return self.wait(
            reader,
            lambda sample: values(sample)["state"] in wanted and others.items() <= values(sample).items(),
        )

    def connect(self, name: str, request: Any, reply: Any) -> tuple[DataWriter, DataReader]:
        """Writer and reader of a service, when it is there."""
        if name not in self.clients:
            to = Topic(self.participant, f"rq/{name}Request", request, qos=PROFILE)
            back = Topic(self.participant, f"rr/{name}Reply", reply, qos=PROFILE)
            writer = DataWriter(self.participant, to, qos=PROFILE)
            reader = DataReader(self.participant, back, qos=PROFILE)
            until = time.monotonic() + DEADLINE_S
            waits = WaitSet(self.participant)
            while not (writer.get_matched_subscriptions() and reader.get_matched_publications()):
                assert time.monotonic() < until, f"there is no service {name}"
                waits.wait(duration(milliseconds=20))
            self.clients[name] = (writer, reader)
        return self.clients[name]

    def call(self, name: str, request: Any, reply: Any, *fields: Any) -> tuple[Any, float]:
        """The reply, and the time from the call to it, s."""
        writer, reader = self.connect(name, request, reply)
        number = next(self.numbers)
        begun = time.monotonic()
        writer.write(request(0x0123456789ABCDEF, number, *fields))
        answer = self.wait(reader, lambda sample: sample.seq == number)
        assert answer.guid == 0x0123456789ABCDEF
        return answer, time.monotonic() - begun

    def trigger(self, name: str) -> tuple[Any, float]:
        return self.call(f"mcdpr/{name}", m.TriggerRequest, m.TriggerReply)

    def move_to(self, x: float, y: float, z: float, speed: float = 0.0) -> Any:
        fields = (m.Point(x, y, z), speed)
        return self.call("mcdpr/move_to", m.MoveToRequest, m.MoveToReply, *fields)[0]

    def run_task(self, task: str) -> Any:
        return self.call("mcdpr/run_task", m.RunTaskRequest, m.RunTaskReply, task)[0]


def values(sample: Any) -> dict[str, str]:
    return {value.key: value.value for value in sample.status[0].values}


@contextlib.contextmanager
def serving(folder: Path, domain: int, *words: str) -> Iterator[subprocess.Popen[str]]:
    """`mcdpr ros` with these words."""
    command = [PROGRAM, "ros", "--json", "--domain", str(domain), *words]
    # The files that it keeps of a robot belong to this test only.
    own = {**os.environ, "XDG_STATE_HOME": str(folder)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=folder, env=own) as process:
        assert process.stdout is not None
        try:
            said = json.loads(process.stdout.readline())
            assert said["domain"] == domain and said["interfaces"] == ["127.0.0.1"]
            yield process
        finally:
            process.terminate()
        assert process.wait(timeout=DEADLINE_S) in (0, 130)


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[subprocess.Popen[str]]:
    """A simulated robot in real time."""
    with serving(tmp_path_factory.mktemp("robot"), DOMAIN, "--camera") as process:
        yield process


@pytest.fixture(scope="module")
def ros(robot: subprocess.Popen[str]) -> Ros:
    return Ros(DOMAIN)
