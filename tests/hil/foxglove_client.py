"""Client of Foxglove's websocket protocol, version 1, on plain sockets: it reads what a viewer reads."""

import base64
import json
import os
import socket
import struct
from typing import Any


class Client:
    """A connected client that reads on demand."""

    def __init__(self, port):
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=10.0)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._file = self._socket.makefile("rb")
        assert b" 101 " in self._file.readline()
        while self._file.readline().strip():
            pass
        self.channels: dict[str, Any] = {}
        while not self.channels:
            opcode, data = self.frame()
            if opcode == 1 and (message := json.loads(data))["op"] == "advertise":
                self.channels = {c["topic"]: c for c in message["channels"]}

    def subscribe(self, *topics):
        subscriptions = [{"id": i, "channelId": self.channels[t]["id"]} for i, t in enumerate(topics)]
        data = json.dumps({"op": "subscribe", "subscriptions": subscriptions}).encode()
        mask = os.urandom(4)
        head = struct.pack("!BBH", 0x81, 0x80 | 126, len(data)) + mask
        self._socket.sendall(head + bytes(b ^ mask[i % 4] for i, b in enumerate(data)))

    def messages(self, quiet_s):
        """Subscription, time in ns and payload of each message until the server is quiet or closed."""
        self._socket.settimeout(quiet_s)
        opcode = 2
        while opcode != 8:
            try:
                opcode, data = self.frame()
            except (OSError, struct.error):
                return
            if opcode == 2 and data[0] == 1:
                number, t_ns = struct.unpack_from("<IQ", data, 1)
                yield number, t_ns, data[13:]

    def frame(self):
        """Opcode and payload of the next frame."""
        first, length = struct.unpack("!BB", self._file.read(2))
        length &= 0x7F
        if length >= 126:
            (length,) = struct.unpack(
                *(("!H", self._file.read(2)) if length == 126 else ("!Q", self._file.read(8)))
            )
        return first & 0x0F, self._file.read(length)

    def close(self):
        self._file.close()
        self._socket.close()
