"""The CAN bus: interfaces, bit time, arbitration between processes."""
