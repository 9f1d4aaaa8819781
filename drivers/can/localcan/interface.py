"""LocalCanBus: the virtual bus localcan as a python-can interface, for its viewer, logger and player."""

import errno
import struct
import time
from collections import deque
from typing import Any

import can
from can.typechecking import CanFilters, Channel

from drivers.can.bus_time import BitTiming
from drivers.can.link import collect
from drivers.can.localcan.participant import DEFAULT_TIMING, Participant
from drivers.can.messages import from_message, to_message
from drivers.errors import HilError
from drivers.frame_array import sent_array, unpack_frames

_FOREVER_NS = 1 << 62


class LocalCanBus(can.BusABC):
    """python-can bus on a localcan channel.

    channel: any name. bitrate, data_bitrate (bit/s), fd: the first participant that sets them fixes them for
    all. If left out, the present values apply (1M/5M, CAN FD if nobody has set any).
    receive_own_messages: deliver own messages too, with is_rx False.

    Message.timestamp is Unix time of the frame's end, minus the standstill of virtual time since joining.
    Filters are applied in software. Mutable state: the participant and the messages received but not taken.
    Raises can.CanInitializationError if the timing differs or the runtime folder cannot be used.
    """

    def __init__(
        self,
        channel: Channel = "hil0",
        can_filters: CanFilters | None = None,
        bitrate: int | None = None,
        data_bitrate: int | None = None,
        fd: bool | None = None,
        receive_own_messages: bool = False,
        timing: can.BitTiming | can.BitTimingFd | None = None,
        **kwargs: Any,
    ) -> None:
        if isinstance(timing, can.BitTimingFd):
            bitrate, data_bitrate, fd = timing.nom_bitrate, timing.data_bitrate, True
        elif timing is not None:
            bitrate, fd = timing.bitrate, False
        slow, fast = bitrate or DEFAULT_TIMING.bitrate, data_bitrate or DEFAULT_TIMING.data_bitrate
        rates = None if bitrate is data_bitrate is None else BitTiming(int(slow), int(fast))
        try:
            self._node = Participant(str(channel), rates, fd=fd, own=receive_own_messages)
        except HilError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel_info = f"localcan {channel}"
        self._inbox: deque[Any] = deque()
        self._epoch_ns = time.time_ns() - self._node.clock.now()
        self._can_protocol = can.CanProtocol.CAN_FD if self._node.mode.fd else can.CanProtocol.CAN_20
        super().__init__(channel, can_filters, **kwargs)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        inbox = self._inbox
        if not inbox:
            deadline = _FOREVER_NS if timeout is None else self._node.clock.now() + int(timeout * 1e9)
            inbox.extend(unpack_frames(collect(self._node, deadline).tobytes()))
        message = to_message(inbox.popleft(), self._epoch_ns, self._node.channel) if inbox else None
        # select() on fileno() has to return as long as there is something to take
        if inbox or not self._node.arm():
            self._node.ring()
        return message, False

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message. Raises can.CanOperationError (ENOBUFS) if no room is free within `timeout` s."""
        end = time.monotonic() + (timeout or 0.0)
        try:
            frames = sent_array([from_message(msg)])
            while not self._node.send(frames):
                if time.monotonic() >= end:
                    raise can.CanOperationError(
                        f"localcan {self._node.channel}: transmit queue full, the bus is overloaded",
                        error_code=errno.ENOBUFS,
                    )
                time.sleep(1e-4)
        except (HilError, struct.error) as error:
            raise can.CanOperationError(str(error)) from error

    def flush_tx_buffer(self) -> None:
        """Drop this node's messages whose transmission has not started."""
        self._node.flush_tx()

    def fileno(self) -> int:
        """File descriptor that is readable when `recv` may have a message."""
        return self._node.fileno()

    def shutdown(self) -> None:
        """Leave the bus and release its resources."""
        super().shutdown()
        if hasattr(self, "_node"):
            self._node.close()
