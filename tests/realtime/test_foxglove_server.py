"""The live view on the rings of a run that tests write themselves."""

import gc
import json
import os
import socket
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import pytest
from live_client import BURST, CALL, MESSAGE, watching
from websockets.client import ClientProtocol
from websockets.protocol import State
from websockets.sync.client import connect
from websockets.uri import parse_uri

from inteco_abs.config import load_config
from inteco_abs.control import GainChange
from inteco_abs.errors import AbsError, ConfigError
from inteco_abs.experiment import Plan, run_stop
from inteco_abs.format import TICK, pack_tick
from inteco_abs.realtime.foxglove_server import MOST_VIEWERS, PERIOD_S, require_foxglove
from inteco_abs.realtime.gain_changes import ChangeTable
from inteco_abs.realtime.live_view import live_view
from inteco_abs.realtime.memory import Field, Mailbox, alive
from inteco_abs.realtime.ring import RingReader
from inteco_abs.signals import Phase, Tick


def tick(number, phase=Phase.IDLE):
    values = dict.fromkeys(Tick._fields, 0.0) | {"time_ns": 10**9 + 500_000 * number, "tick": number, "slip": 0.5}
    values["phase"] = phase
    integers = [column.name for column in TICK.columns if column.kind.code not in "df"]
    return Tick(**{name: int(value) if name in integers else value for name, value in values.items()})


class Loop:
    """Writes ticks into the ring, numbered from 0."""

    def __init__(self, memory):
        self._ring = memory.tick_ring(pack_tick)
        self.number = -1

    def append(self, ticks=1, phase=Phase.IDLE):
        self.number += ticks
        self._ring.append(tick(self.number, phase))

    def reach(self, viewer):
        """Write until the viewer is subscribed; the message of the last tick written, which is all that it has yet."""
        while True:
            self.append()
            with suppress(TimeoutError):
                while True:
                    found = viewer.next(0.1)
                    if viewer.decode(found[1]).tick == self.number:
                        return found


@pytest.fixture
def memory(new_memory):
    return new_memory(ticks=5000)


@pytest.fixture
def job(memory, job_of):
    return replace(job_of(memory), live_port=0)


@pytest.fixture
def loop(memory):
    return Loop(memory)


def test_nothing_is_served_unless_it_was_requested(memory, job):
    with live_view(memory, replace(job, live_port=None)):
        assert memory.words[Field.LIVE_PORT] == 0


def test_a_viewer_gets_the_rings_newest_tick(memory, job, loop):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
        _, data = loop.reach(viewer)
        decoded = viewer.decode(data)
    assert data == memory.tick_reader().newest()
    assert (decoded.tick, decoded.slip) == (loop.number, 0.5)


def test_a_viewer_gets_the_description_of_the_channel(memory, job):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
        assert viewer.subprotocol == "foxglove.sdk.v1"
        assert viewer.info["name"] == "inteco-abs"
        channel = viewer.channels[TICK.topic]
    assert (channel["schemaName"], channel["encoding"]) == (TICK.name, "protobuf")


def test_times_keep_the_distance_that_ticks_have(memory, job, loop):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
        first, _ = loop.reach(viewer)
        loop.append(40)
        second, _ = viewer.next()
    assert second - first == 20_000_000


def test_ticks_come_once_each_and_at_most_a_hundred_a_second(memory, job, loop):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
        loop.reach(viewer)
        began = time.monotonic()
        for _ in range(40):
            loop.append()
            time.sleep(PERIOD_S / 10)
        last = loop.number
        numbers = []
        while last not in numbers:
            numbers.append(viewer.decode(viewer.next()[1]).tick)
        took_s = time.monotonic() - began
    assert numbers == sorted(set(numbers))
    assert len(numbers) <= took_s / PERIOD_S + 2
    assert memory.tick_reader().taken == 0


def test_the_channel_survives_the_garbage_collector(memory, job, loop):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
        loop.reach(viewer)
        for _ in range(5):
            gc.collect()
            loop.append()
            assert viewer.decode(viewer.next()[1]).tick == loop.number


def test_a_viewer_that_comes_late_gets_every_event_however_short(memory, job, loop):
    with live_view(memory, job):
        for phase in (Phase.IDLE, Phase.ARMED, Phase.SPIN_UP, Phase.SPIN_UP, Phase.BRAKING):
            loop.append(phase=phase)
        with watching(memory.words[Field.LIVE_PORT], "/abs/event") as viewer:
            found = [viewer.next_of("/abs/event") for _ in range(4)]
            decoded = [viewer.decode(data, "/abs/event") for _, _, data in found]
    assert [each.message for each in decoded] == ["phase IDLE", "phase ARMED", "phase SPIN_UP", "phase BRAKING"]
    epoch_ns = memory.words[Field.EPOCH_NS]
    assert [time_ns - epoch_ns for _, time_ns, _ in found] == [10**9 + 500_000 * number for number in (0, 1, 2, 4)]


def test_parameters_and_names_of_internals_come_once_the_board_has_answered(memory, job):
    with live_view(memory, job), watching(memory.words[Field.LIVE_PORT], "/abs/params") as viewer:
        memory.post(
            Mailbox.HEADER, {"gains": {"Mk": 2.5}, "internals": ["f", "g"], "declared": [["Mk", "1/s", "rate"]]}
        )
        _, _, data = viewer.next_of("/abs/params")
        assert dict(viewer.decode(data, "/abs/params").values) == {"Mk": 2.5, "reference_slip": 0.2}
        with watching(memory.words[Field.LIVE_PORT], "/abs/params") as other:
            assert other.next_of("/abs/params")[2] == data
            facts = other.info["metadata"]
    assert facts["/abs/tick internals"] == '["f", "g"]'
    assert json.loads(facts["/abs/params units"])["Mk"] == "1/s"
    assert json.loads(facts["/abs/tick units"])["torque_demand_nm"] == "N.m"


def test_a_change_of_a_gain_comes_with_the_time_of_its_tick(memory, job, loop):
    memory.post(Mailbox.HEADER, {"gains": {"Mk": 2.5}, "internals": [], "declared": [["Mk", "1/s", "rate"]]})
    with live_view(memory, job):
        table = ChangeTable(memory, ["Mk"])
        loop.append(phase=Phase.IDLE)
        table.record(GainChange(loop.number + 2, "Mk", 7.5))
        for _ in range(3):
            loop.append(phase=Phase.IDLE)
        with watching(memory.words[Field.LIVE_PORT], "/abs/params", "/abs/event") as viewer:
            found = [viewer.next_of("/abs/params", "/abs/event") for _ in range(4)]
    said = [(time_ns, viewer.decode(data, topic)) for topic, time_ns, data in found]
    (when, change), *_ = [(when, each) for when, each in said if getattr(each, "tick", 0)]
    assert dict(change.values) == {"Mk": 7.5}
    texts = {each.message: when for when, each in said if hasattr(each, "message")}
    assert texts[f"Mk = 7.5 from tick {change.tick}"] == when


def test_warnings_and_the_result_come_too(memory, job):
    with live_view(memory, job) as view, watching(memory.words[Field.LIVE_PORT], "/abs/event", "/abs/result") as viewer:
        view.warn("the disk is slow", 5 * 10**9)
        view.finish({"lateness_us": {}, "stop_time_s": 1.25})
        found = {topic: (time, data) for topic, time, data in (viewer.next_of(*viewer.channels) for _ in range(2))}
        time_ns, warning = found["/abs/event"]
        assert viewer.decode(warning, "/abs/event").message == "the disk is slow"
        assert time_ns == memory.words[Field.EPOCH_NS] + 5 * 10**9
        assert viewer.decode(found["/abs/result"][1], "/abs/result").stop_time_s == 1.25


class TestBursts:
    """Every tick of the last milliseconds, when a viewer calls for them."""

    @pytest.fixture
    def viewer(self, memory, job, loop):
        for _ in range(1000):
            loop.append()
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT], BURST) as viewer:
            yield viewer

    def test_it_has_every_tick(self, viewer, memory, loop):
        messages, response = viewer.call(1, {"ms": 300})
        ticks, _ = memory.tick_reader().look(400)
        assert b"".join(data for _, data in messages) == ticks
        assert [time - memory.words[Field.EPOCH_NS] for time, _ in messages] == TICK.array(ticks)["time_ns"].tolist()
        assert response == {"ticks": 600, "first_tick": 400, "last_tick": 999}
        assert memory.tick_reader().taken == 0
        loop.append()
        assert viewer.call(1, {"ms": 0.5}, number=2)[1] == {"ticks": 1, "first_tick": 1000, "last_tick": 1000}

    @pytest.mark.parametrize(
        ("service", "request_", "why"),
        [
            (1, {"ms": 501}, "ms is 501: the run has 500 ms of ticks so far; ask for fewer"),
            (1, {"ms": 0}, "ms is 0: must be a number above 0, at most 2000"),
            (1, {"ms": 2000.5}, "ms is 2000.5: must be a number above 0, at most 2000"),
            (1, b'{"ms": NaN}', "ms is nan: must be a number above 0, at most 2000"),
            (1, {"ms": True}, "ms is True: must be a number above 0, at most 2000"),
            (1, {}, "ms is None: must be a number above 0, at most 2000"),
            (1, [1], "the request must be a JSON object"),
            (1, b"{", "the request must be a JSON object"),
            (2, {"ms": 1}, "no service 2: must be one of 1"),
        ],
    )
    def test_what_cannot_be_had_is_refused_with_the_reason(self, viewer, service, request_, why):
        assert viewer.call(service, request_) == ([], why)
        assert viewer.call(1, {"ms": 1})[1]["ticks"] == 2

    def test_ticks_that_memory_no_longer_holds_are_refused(self, new_memory, job_of):
        memory = new_memory(ticks=200)
        loop = Loop(memory)
        for _ in range(400):
            memory.tick_reader().release(max(0, loop.number))
            loop.append()
        job = replace(job_of(memory), live_port=0)
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT], BURST) as viewer:
            why = "ms is 100: memory holds the last 87 ms; ask for fewer"
            assert viewer.call(1, {"ms": 100}) == ([], why)
            assert viewer.call(1, {"ms": 87}, number=2)[1]["first_tick"] == 400 - 174

    def test_it_needs_a_subscription_and_the_previous_answer(self, memory, viewer):
        with watching(memory.words[Field.LIVE_PORT]) as other:
            assert other.call(1, {"ms": 10}) == ([], "subscribe to /abs/burst first")
        call = CALL.pack(2, 1, 1, 4) + b'json{"ms": 500}'
        viewer.raw(call)
        assert viewer.call(1, {"ms": 1}, number=1)[1] == "the previous call is not answered yet; wait for it"

    @pytest.mark.parametrize(
        "said", [b"\2", CALL.pack(2, 1, 1, 1 << 31), CALL.pack(2, 1, 1, 4) + b"json" + b"[" * 60_000]
    )
    def test_bytes_that_are_not_a_call_disturb_no_other_viewer(self, memory, viewer, said):
        with watching(memory.words[Field.LIVE_PORT], BURST) as other:
            other.raw(said)
            assert viewer.call(1, {"ms": 1})[1]["ticks"] == 2

    def test_a_caller_that_reads_nothing_disturbs_no_other(self, memory, viewer):
        with watching(memory.words[Field.LIVE_PORT], BURST) as other:
            for _ in range(20):
                other.raw(CALL.pack(2, 1, 1, 4) + b'json{"ms": 500}')
            assert viewer.call(1, {"ms": 500})[1]["ticks"] == 1000


def test_connections_from_other_computers_are_refused(memory, job):
    with live_view(memory, job):
        port = f":{memory.words[Field.LIVE_PORT]:04X}"
        rows = [line.split() for name in ("tcp", "tcp6") for line in Path("/proc/net", name).read_text().splitlines()]
        listening = [row[1] for row in rows if row[1].endswith(port) and row[3] == "0A"]
    assert listening == [f"0100007F{port}"]


def test_a_port_that_is_taken_is_named_with_what_to_do(memory, job):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with (
            pytest.raises(AbsError, match=f"ws://127.0.0.1:{port} cannot be served: .* name another port, or 0"),
            live_view(memory, replace(job, live_port=port)),
        ):
            raise AssertionError("it was served")
    assert memory.words[Field.LIVE_PORT] == 0


def test_a_taken_port_is_reported_before_a_run_begins_and_a_free_one_stays_free():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(AbsError, match=f"ws://127.0.0.1:{port} cannot be served: .* name another port, or 0"):
            require_foxglove(port)
    for _ in range(2):
        require_foxglove(port)
    require_foxglove(0)


def test_trouble_while_serving_ends_the_view_and_nothing_else(memory, job, loop, monkeypatch, capfd):
    def fail(*_args, **_options):
        raise RuntimeError("no more room")

    monkeypatch.setattr(RingReader, "look", fail)
    with live_view(memory, job):
        loop.append()
    assert capfd.readouterr().err == "inteco-abs: the live view has ended, and the run continues: no more room\n"


def refuses(port):
    try:
        socket.create_connection(("127.0.0.1", port)).close()
    except ConnectionRefusedError:
        return True
    return False


def test_it_is_gone_afterwards(memory, job, until):
    with live_view(memory, job):
        port = memory.words[Field.LIVE_PORT]
        assert not refuses(port)
    until(lambda: refuses(port))


def test_a_missing_extra_is_named(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    with pytest.raises(AbsError, match=r"--foxglove needs websockets: pip install 'inteco-abs\[foxglove\]'"):
        require_foxglove(0)


def descriptors():
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


class TestStrangers:
    """Any program of this computer can connect, and any page in a browser here can make the browser do so."""

    @staticmethod
    def status(port, **headers):
        """Status of the answer to a handshake with these headers; 101 switches to the protocol."""
        lines = {
            "Host": f"127.0.0.1:{port}", "Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13",
            "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "foxglove.sdk.v1", **headers,
        }  # fmt: skip
        with socket.create_connection(("127.0.0.1", port), 10.0) as connection:
            request = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
            connection.sendall(f"GET / HTTP/1.1\r\n{request}\r\n".encode())
            return int(connection.recv(100).split()[1])

    @pytest.mark.parametrize(
        "origin",
        ["http://evil.example", "https://localhost.evil.example", "null", "https://foxglove.dev", "http://[::2]"],
    )
    def test_a_page_of_elsewhere_is_refused(self, memory, job, origin):
        with live_view(memory, job):
            assert self.status(memory.words[Field.LIVE_PORT], Origin=origin) == 403

    @pytest.mark.parametrize("host", ["evil.example", "evil.example:{port}", "127.0.0.1", "127.0.0.1:1"])
    def test_a_name_of_a_stranger_that_leads_here_is_refused(self, memory, job, host):
        with live_view(memory, job):
            port = memory.words[Field.LIVE_PORT]
            assert self.status(port, Host=host.format(port=port)) == 403

    @pytest.mark.parametrize(
        "origin", ["http://localhost:8080", "https://127.0.0.1", "https://app.foxglove.dev", "file://"]
    )
    def test_viewers_of_this_computer_and_the_foxglove_app_are_let_in(self, memory, job, origin):
        with live_view(memory, job):
            port = memory.words[Field.LIVE_PORT]
            assert self.status(port, Origin=origin) == 101
            assert self.status(port, Origin=origin, Host=f"localhost:{port}") == 101

    @pytest.mark.long
    def test_many_silent_connections_take_few_descriptors_and_others_continue(self, memory, job, loop, until):
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
            loop.reach(viewer)
            held = descriptors()
            idle = [socket.socket() for _ in range(400)]
            for each in idle:
                each.connect(("127.0.0.1", memory.words[Field.LIVE_PORT]))
            loop.reach(viewer)
            until(lambda: descriptors() <= held + len(idle) + MOST_VIEWERS, "the rest is sent away")
            assert alive(os.getpid())
            for each in idle:
                each.close()

    @pytest.mark.parametrize(
        "said",
        [
            b"garbage\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"\x16\x03\x01\x02\x00", b"\0" * 70_000, b"",
        ],
        ids=["words", "no websocket", "TLS", "zeros", "nothing"],
    )  # fmt: skip
    def test_bytes_that_are_not_a_handshake_disturb_no_viewer(self, memory, job, loop, said):
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
            for _ in range(MOST_VIEWERS + 4):
                with suppress(OSError), socket.create_connection(("127.0.0.1", memory.words[Field.LIVE_PORT])) as other:
                    other.sendall(said)
            loop.reach(viewer)

    @pytest.mark.parametrize(
        "said",
        [
            "[]",
            '{"op": "subscribe"}',
            '{"op": "subscribe", "subscriptions": [{"id": -1, "channelId": 1}]}',
            "[" * 60_000,
            '{"op": "unsubscribe", "subscriptionIds": [[]]}',
            "x" * 100_000,
            b"binary",
        ],
        ids=range(7),
    )
    def test_bytes_that_are_not_a_message_disturb_no_other_viewer(self, memory, job, loop, said):
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
            address = f"ws://127.0.0.1:{memory.words[Field.LIVE_PORT]}"
            with connect(address, subprotocols=["foxglove.sdk.v1"]) as other:  # not before the first has its answer
                other.send(said)
                loop.reach(viewer)

    @pytest.fixture
    def slow(self, memory, job, monkeypatch):
        """A viewer with little room for what it has not read, with many subscriptions: its protocol and its socket."""

        def create_server(address):
            server = create(address)
            server.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)  # it is full sooner
            return server

        create = socket.create_server
        monkeypatch.setattr(socket, "create_server", create_server)
        subscriptions = [{"id": number, "channelId": 1 if number else 4} for number in range(MOST_VIEWERS)]
        with live_view(memory, job), socket.socket() as other:
            port = memory.words[Field.LIVE_PORT]
            other.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            other.connect(("127.0.0.1", port))
            client = ClientProtocol(parse_uri(f"ws://127.0.0.1:{port}"), subprotocols=["foxglove.sdk.v1"])
            client.send_request(client.connect())
            other.sendall(b"".join(client.data_to_send()))
            while client.state is not State.OPEN:
                client.receive_data(other.recv(4096))
            client.send_text(json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode())
            other.sendall(b"".join(client.data_to_send()))
            yield client, other

    def test_a_viewer_that_reads_nothing_and_closes_disturbs_no_other(self, memory, loop, slow):
        client, other = slow
        for _ in range(40):
            loop.append()
            time.sleep(PERIOD_S)
        client.send_close(1000)
        other.sendall(b"".join(client.data_to_send()))
        with watching(memory.words[Field.LIVE_PORT]) as viewer:
            for _ in range(40):
                loop.append()
                other.recv(4096)
                time.sleep(PERIOD_S)
            loop.reach(viewer)

    def test_a_slow_viewer_misses_ticks_but_no_event(self, loop, slow):
        client, other = slow
        changes = 60
        for number in range(changes):
            loop.append(phase=(Phase.IDLE, Phase.ARMED)[number % 2])
            time.sleep(PERIOD_S)
        other.settimeout(10.0)
        events = ticks = 0
        while events < changes:
            client.receive_data(other.recv(4096))
            data = [event.data for event in client.events_received() if getattr(event, "opcode", 0) == 2]  # binary
            heads = [MESSAGE.unpack_from(each) for each in data]
            events += sum(subscription == 0 for _, subscription, _ in heads)
            ticks += sum(subscription > 0 for _, subscription, _ in heads)
        assert 0 < ticks < changes * (MOST_VIEWERS - 1)

    def test_ticks_stop_when_a_viewer_unsubscribes(self, memory, job, loop):
        with live_view(memory, job), watching(memory.words[Field.LIVE_PORT]) as viewer:
            loop.reach(viewer)
            viewer.unsubscribe()
            loop.append()
            with suppress(TimeoutError):
                for _ in range(5):
                    viewer.next(0.3)
            loop.append()
            with pytest.raises(TimeoutError):
                viewer.next(0.3)


def test_a_run_in_virtual_time_has_nothing_to_look_at(tmp_path):
    with pytest.raises(ConfigError, match="--foxglove: a run in virtual time ends too soon to be viewed"):
        run_stop(load_config(), Plan(tmp_path / "stop.mcap", virtual=True, live_port=0))
    assert list(tmp_path.iterdir()) == []
