"""Which drive a frame of CANopen concerns: the predefined connection set says it by the node number."""

from drivers.cia402 import objects as o
from drivers.cia402.kernels import STRANGE
from drivers.identity import REVISION, SERIAL, Said
from drivers.protocol import OTHER_BUSES, Frame

FOREIGN = STRANGE | OTHER_BUSES
"""Flags of frames that cannot be ours."""
_NODE = 0x7F
_FROM_DRIVES = frozenset((o.EMCY_ID, *o.TPDO_ID, o.SDO_REPLY_ID, o.HEARTBEAT_ID))
_IDENTITY = {o.SERIAL: SERIAL, o.REVISION: REVISION}


class Routes:
    """What a frame's identifier says, for six nodes."""

    node_ids: tuple[int, ...]
    """Leg order."""

    def sender(self, frame: Frame) -> int:
        """Return the leg of a PDO, SDO, EMCY or heartbeat of one of the drives."""
        node = frame.id & _NODE
        ours = frame.id & ~_NODE in _FROM_DRIVES and node in self.node_ids
        return self.node_ids.index(node) if ours else -1

    def identity_requests(self) -> tuple[tuple[Frame, ...], ...]:
        """Return SDO requests for the identity object, 0x1018."""
        return tuple(
            tuple(Frame(o.SDO_REQUEST_ID + node, o.upload(key)) for node in self.node_ids)
            for key in _IDENTITY
        )

    def identity(self, frame: Frame) -> Said | None:
        """Return what an SDO answer says of the identity object; an abort says nothing."""
        leg = self.sender(frame)
        if leg < 0 or frame.id & ~_NODE != o.SDO_REPLY_ID or frame.flags & FOREIGN:
            return None
        reply = o.read_reply(frame.data)
        if reply is None or reply.abort or reply.wrote or reply.key not in _IDENTITY:
            return None
        return Said(leg, _IDENTITY[reply.key], reply.value)
