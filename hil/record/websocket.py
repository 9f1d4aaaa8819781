"""The log's messages to Foxglove and Lichtblick while they are written, over a websocket.

The SDK sends in threads of its own; a client that reads too slowly loses the oldest messages.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from typing import Any

from drivers.errors import LogError
from hil.record.encode import Messages
from hil.record.layout import RECORD_HEADER
from hil.record.schema import LIBRARY, Schema

BACKLOG = 8192
"""Messages that wait for one client, at most; a batch of 0.1 s at 1 kHz has some 1,600."""
GOODBYE_S = 1.0
"""Time that the clients have at the end of a run."""


class LiveSocket:
    """A server on which clients subscribe to the channels of a log. State: the server; None once it failed.

    Raises LogError: foxglove-sdk is not installed, or nothing can listen at host and port.
    """

    def __init__(
        self, host: str, port: int, channels: Mapping[int, tuple[str, Schema, dict[str, str]]]
    ) -> None:
        try:
            import foxglove  # noqa: PLC0415 - an extra
        except ImportError as error:
            raise LogError(
                f"recording.websocket: needs foxglove-sdk, which is not installed ({error}): "
                'pip install "hexapod-hil[viewers]", or leave recording.websocket out'
            ) from error
        foxglove.set_log_level("CRITICAL")  # what a client does wrong is no news to the operator
        self._context = foxglove.Context()  # the server holds it weakly
        try:
            self._server: Any = foxglove.start_server(
                name=LIBRARY, host=host, port=port, context=self._context, message_backlog_size=BACKLOG
            )
        except RuntimeError as error:
            raise LogError(
                f"recording.websocket: {host}:{port}: {error}: name another port, or end who listens there"
            ) from error
        self._channels = {
            number: foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=schema.name, encoding="protobuf", data=schema.descriptors),
                message_encoding="protobuf",
                metadata=metadata,
                context=self._context,
            )
            for number, (topic, schema, metadata) in channels.items()
        }

    def publish(self, messages: Messages) -> None:
        """Hand a batch to the clients of its channels. Never raises, never waits for a client."""
        if self._server is None:
            return
        heard = {number: channel for number, channel in self._channels.items() if channel.has_sinks()}
        if not heard:
            return
        try:
            for number, log_time, record in zip(
                messages.channel.tolist(), messages.log_time.tolist(), messages.records(), strict=True
            ):
                if number in heard:
                    heard[number].log(bytes(record[RECORD_HEADER:]), log_time=log_time)
        except RuntimeError:  # the log goes on without its viewers
            self.close()

    def close(self) -> bool:
        """Send what still waits and say goodbye; return whether all clients took it within GOODBYE_S."""
        if self._server is None:
            return True
        goodbye = threading.Thread(target=self._server.stop, daemon=True)
        self._server = None
        goodbye.start()
        goodbye.join(GOODBYE_S)
        return not goodbye.is_alive()
