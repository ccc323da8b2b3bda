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
SUBSCRIPTION = 7


@contextmanager
def watching(port):
    """A viewer of the live view at `port`."""
    with connect(f"ws://127.0.0.1:{port}", subprotocols=["foxglove.sdk.v1"], open_timeout=30) as connection:
        yield Viewer(connection)


class Viewer:
    """Subscribes to the only channel of a live view."""

    def __init__(self, connection):
        self._socket = connection
        self.info = json.loads(self._socket.recv(30))
        (self.channel,) = json.loads(self._socket.recv(30))["channels"]
        pool = DescriptorPool()
        for file in FileDescriptorSet.FromString(base64.b64decode(self.channel["schema"])).file:
            pool.Add(file)
        self.decode = GetMessageClass(pool.FindMessageTypeByName(self.channel["schemaName"])).FromString
        subscription = {"id": SUBSCRIPTION, "channelId": self.channel["id"]}
        self._socket.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))

    @property
    def subprotocol(self):
        return self._socket.subprotocol

    def next(self, most_s=30.0):
        """Time and bytes of the next message; raises TimeoutError."""
        while True:
            data = self._socket.recv(most_s)
            if isinstance(data, bytes):
                kind, subscription, log_time = MESSAGE.unpack_from(data)
                assert (kind, subscription) == (1, SUBSCRIPTION)
                return log_time, data[MESSAGE.size :]

    def unsubscribe(self):
        self._socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [SUBSCRIPTION]}))

    def rest(self):
        """All messages until the server is gone."""
        messages = [data for data in self._socket if isinstance(data, bytes)]
        return [(MESSAGE.unpack_from(data)[2], data[MESSAGE.size :]) for data in messages]
