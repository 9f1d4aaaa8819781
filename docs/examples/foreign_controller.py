"""A controller of one's own for `hil plant bench`, in python-can and cantools: sets up, moves, parks.

Start `hil plant bench`, then `python docs/examples/foreign_controller.py drivers/legs/legs.dbc bench0`.
"""

import sys
import time
from collections.abc import Callable

import can
import cantools

DBC, CHANNEL = sys.argv[1:3]
RATED_N, PERIOD_S, WATCHDOG_S = 10_000.0, 0.01, 0.15  # the first is drives.force_limit_N of the configuration
OFF, READY, RUN = 0, 1, 2  # Mode; the states that answer to them are one more
db = cantools.database.load_file(DBC)
bus = can.Bus(CHANNEL, "localcan", fd=True, ignore_config=True)
cycle, status, legs = 0, {}, {}


def crc(data: bytes, width: int) -> int:
    """CRC-8 of SAE J1850, or CRC-16/M17."""
    polynomial, final = {8: (0x1D, 0xFF), 16: (0x5935, 0)}[width]
    register = (1 << width) - 1
    for bit in (byte >> k & 1 for byte in data for k in range(7, -1, -1)):
        carry = register >> width - 1 ^ bit
        register = (register << 1 & (1 << width) - 1) ^ (polynomial if carry else 0)
    return register ^ final


def send(name: str, **fields: float) -> bytes:
    """Send a message with its check over identifier and all bytes before it; return these bytes."""
    message = db.get_message_by_name(name)
    check = message.get_signal_by_name("CRC")
    covered = (
        message.frame_id.to_bytes(2, "little") + message.encode({**fields, "CRC": 0})[: check.start // 8]
    )
    data = message.encode({**fields, "CRC": crc(covered, check.length)})
    fd = message.is_fd
    bus.send(
        can.Message(
            arbitration_id=message.frame_id, data=data, is_extended_id=False, is_fd=fd, bitrate_switch=fd
        )
    )
    return covered


def nothing(_leg: int) -> float:
    """No force."""
    return 0.0


def tick(mode: int, force: Callable[[int], float] = nothing) -> bool:
    """SYNC, six answers, command; tell whether all drives are in the state that the mode asks for."""
    global cycle
    begun, cycle, fresh = time.monotonic(), (cycle + 1) % 256, set()
    send("SYNC", Cycle=cycle)
    while len(fresh) < 6 and (heard := bus.recv(max(0.0, begun + PERIOD_S / 2 - time.monotonic()))):
        name, data = db.get_message_by_frame_id(heard.arbitration_id).name, bytes(heard.data)
        if crc(heard.arbitration_id.to_bytes(2, "little") + data[:-1], 8) != data[-1]:
            continue
        values = db.decode_message(heard.arbitration_id, data, decode_choices=False)
        if name.startswith("STATUS"):
            status[int(name[-1])] = values
        elif name.startswith("FEEDBACK_FD") and values["Counter"] == cycle % 16:
            legs[int(name[-1])] = values
            fresh.add(int(name[-1]))
    send("COMMAND_FD", **{f"Force{leg}": force(leg) for leg in range(1, 7)}, Counter=cycle, Mode=mode)
    time.sleep(max(0.0, begun + PERIOD_S - time.monotonic()))
    return len(fresh) == 6 and all(legs[leg]["State"] == mode + 1 for leg in range(1, 7))


def hold(goal: dict[int, float]) -> Callable[[int], float]:
    """A spring and a damper in each leg."""
    return lambda leg: 2e4 * (goal[leg] - legs[leg]["Length"]) - 4e3 * legs[leg]["Rate"]


rated = round(RATED_N * 1000).to_bytes(4, "little")
for leg in range(1, 7):  # a drive is set up when its status says so
    while status.get(leg, {}).get("SetUp") != crc(
        send(f"CONFIG_{leg}", Watchdog=WATCHDOG_S, Reaction=0, Leg=leg, Version=2) + rated, 16
    ):
        tick(OFF)
while not tick(READY):
    pass
start = {leg: values["Length"] for leg, values in legs.items()}
for k in range(300):
    goal = {leg: length + 0.02 * min(1.0, k / 200) for leg, length in start.items()}
    tick(RUN, hold(goal))
print("moved by", ", ".join(f"{1e3 * (legs[leg]['Length'] - start[leg]):.1f}" for leg in start), "mm")
for mode in (READY, OFF):  # the brakes close with the force on, then it goes
    while not tick(mode, hold(goal)):
        pass
bus.shutdown()
