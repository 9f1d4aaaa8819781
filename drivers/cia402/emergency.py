"""Error codes of EMCY messages: what they mean, and which the emulated drives send.

Codes: CiA 301, table 26; of drives: CiA 402-2 (IEC 61800-7-201), table of error codes. The first two digits
name the class, by which a code without a row is explained.
"""

from drivers.signals import DriveFault

HEARTBEAT_LOST = 0x8130
CODES = {
    DriveFault.WATCHDOG: HEARTBEAT_LOST,
    DriveFault.OVERFORCE: 0x8311,
    DriveFault.SENSOR: 0x7305,
    DriveFault.STROKE: 0x8612,
}
"""What an emulated drive sends for its fault."""
_MEANINGS = {
    0x2310: "continuous over current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5441: "contact of the enable input",
    0x7121: "motor blocked",
    0x7305: "incremental encoder 1 fault",
    0x7310: "speed",
    0x7380: "position sensor",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    HEARTBEAT_LOST: "life guard or heartbeat error: the controller's heartbeat was not heard",
    0x8140: "recovered from bus off",
    0x8150: "CAN-ID collision",
    0x8210: "PDO not processed because of its length",
    0x8220: "PDO length exceeded",
    0x8250: "RPDO timeout",
    0x8311: "excess torque",
    0x8400: "velocity speed controller",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "sync controller",
}
_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the device's input side",
    0x22: "current inside the device",
    0x23: "current at the device's output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "temperature of the device",
    0x43: "temperature of the drive",
    0x50: "hardware of the device",
    0x60: "software of the device",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x71: "power",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x83: "torque control",
    0x84: "velocity control",
    0x85: "position control",
    0x86: "positioning",
    0x87: "synchronisation",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "specific to the device: see its manual",
}


def meaning(code: int) -> str:
    """Return what an error code says, by its own row or by its class."""
    fitting = _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0, "unknown")
    return _MEANINGS.get(code, fitting)
