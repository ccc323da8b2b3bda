"""A viewer that listens to a run: a websocket client, and the official protobuf library to decode with."""

import base64
import json
import struct
from contextlib import contextmanager

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from websockets.sync.client import connect

MESSAGE = struct.Struct("<BIQ")
CALL = struct.Struct("<BIII")
CONTROL = struct.Struct("<BBfBQI")
STATE = struct.Struct("<BBQfBI")
FIRST = 7
"""Before the numbers of the subscriptions."""
TICKS, BURST = "/abs/tick", "/abs/burst"


@contextmanager
def watching(port, *topics):
    """A viewer of the live view at `port`, subscribed to ticks or to `topics`."""
    options = {"subprotocols": ["foxglove.sdk.v1"], "open_timeout": 30, "close_timeout": 0.5}
    with connect(f"ws://127.0.0.1:{port}", **options) as connection:
        yield Viewer(connection, *topics)


class Viewer:
    """Subscribes to one channel of a live view, or to more."""

    def __init__(self, connection, *topics):
        self._socket = connection
        self._kinds = {}
        self.info = json.loads(self._socket.recv(30))
        self.channels = {each["topic"]: each for each in json.loads(self._socket.recv(30))["channels"]}
        self.subscribe(*topics or [TICKS])

    def _received(self, most_s):
        return self._noted(self._socket.recv(most_s))

    def _noted(self, data):
        """The message; what the server says of itself later on replaces what it said first."""
        if isinstance(data, str) and '"serverInfo"' in data:
            self.info = json.loads(data)
        return data

    @property
    def subprotocol(self):
        return self._socket.subprotocol

    def subscribe(self, *topics):
        numbers = {topic: self.channels[topic]["id"] for topic in topics}
        subscriptions = [{"id": FIRST + number, "channelId": number} for number in numbers.values()]
        self.send({"op": "subscribe", "subscriptions": subscriptions})

    def send(self, request):
        self._socket.send(json.dumps(request))

    def decode(self, data, topic=None):
        """The message, by the schema of its channel."""
        channel = self.channels[topic or TICKS]
        if channel["topic"] not in self._kinds:
            pool = DescriptorPool()
            for file in FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
                pool.Add(file)
            self._kinds[channel["topic"]] = GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return self._kinds[channel["topic"]].FromString(data)

    def raw(self, data):
        self._socket.send(data)

    def next_of(self, *topics, most_s=30.0):
        """Topic, time and bytes of the next message of one of these topics; raises TimeoutError."""
        while True:
            data = self._received(most_s)
            if isinstance(data, bytes) and data[0] == 1:
                _, subscription, log_time = MESSAGE.unpack_from(data)
                topic = list(self.channels)[subscription - FIRST - 1]
                if topic in topics:
                    return topic, log_time, data[MESSAGE.size :]

    def next(self, most_s=30.0):
        """Time and bytes of the next tick; raises TimeoutError."""
        return self.next_of(TICKS, most_s=most_s)[1:]

    def call(self, service, request, number=1):
        """Call a service; its messages before the response, and the response or the failure."""
        payload = request if isinstance(request, bytes) else json.dumps(request).encode()
        self._socket.send(CALL.pack(2, service, number, 4) + b"json" + payload)
        messages = []
        while True:
            data = self._received(30)
            if isinstance(data, str):
                text = json.loads(data)
                if text["op"] == "serviceCallFailure":
                    assert (text["serviceId"], text["callId"]) == (service, number)
                    return messages, text["message"]
            elif data[0] == 3:
                assert CALL.unpack_from(data) == (3, service, number, 4)
                return messages, json.loads(data[CALL.size + 4 :])
            elif MESSAGE.unpack_from(data)[1] == FIRST + self.channels[BURST]["id"]:
                messages.append((MESSAGE.unpack_from(data)[2], data[MESSAGE.size :]))

    def control(self, *, pause, speed, seek_ns=None):
        """Use the playback controls; status, time in ns, speed and whether it sought, as the server answers."""
        seeks = seek_ns is not None
        self._socket.send(CONTROL.pack(3, pause, speed, seeks, seek_ns or 0, 4) + b"name")
        while True:
            data = self._socket.recv(30)
            if isinstance(data, bytes) and data[0] == 5 and data[STATE.size :] == b"name":
                return STATE.unpack_from(data)[1:5]

    def unsubscribe(self):
        self.send({"op": "unsubscribe", "subscriptionIds": [FIRST + self.channels[TICKS]["id"]]})

    def rest(self):
        """Topic, time and bytes of all messages until the server is gone."""
        names = list(self.channels)
        messages = [data for data in map(self._noted, self._socket) if isinstance(data, bytes) and data[0] == 1]
        found = [(MESSAGE.unpack_from(data), data[MESSAGE.size :]) for data in messages]
        return [(names[head[1] - FIRST - 1], head[2], data) for head, data in found]
