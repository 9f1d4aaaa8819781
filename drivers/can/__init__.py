"""The CAN bus: interfaces, duration of frames on the wire, arbitration between processes."""
