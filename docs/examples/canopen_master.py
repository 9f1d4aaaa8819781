"""A CANopen master for CiA 402 drives, in the package canopen: brings one up, moves it by torque, parks it.

Start `hil plant FILE`, then
`python docs/examples/canopen_master.py drivers/cia402/emulated_drive.eds CHANNEL [INTERFACE]`.
"""

import sys
import time

import can
import canopen
from canopen.profiles.p402 import BaseNode402

EDS, CHANNEL = sys.argv[1:3]
INTERFACE = (*sys.argv[3:], "localcan")[0]
NODE, MASTER, PERIOD_S, WATCHDOG_MS = 5, 127, 0.01, 200
COUNTS, SCREW_M, RATED_NM = 131072, 0.02, 9.5  # of the drive: 0x608F, its screw, 0x6076
M_PER_COUNT, N_PER_PERMILLE = SCREW_M / COUNTS, 2 * 3.14159265 * 1e-3 * RATED_NM / SCREW_M

network = canopen.Network(bus=can.Bus(CHANNEL, INTERFACE, ignore_config=True))
network.connect()
drive = network.add_node(BaseNode402(NODE, canopen.import_od(EDS, NODE)))
drive.nmt.send_command(0x80)  # Pre-operational: SDO and mapping
assert drive.sdo[0x1000].raw & 0xFFFF == 402
assert round(1e3 * RATED_NM) == drive.sdo[0x6076].raw
drive.tpdo.read()
drive.rpdo.read()
for pdo, objects, kind in (
    (drive.rpdo[1], (0x6040, 0x6071), 255),  # controlword and target torque, at once
    (drive.tpdo[1], (0x6041, 0x6064, 0x6077), 1),  # statusword, position, torque, at every SYNC
    (drive.tpdo[2], (0x606C,), 1),  # velocity
):
    pdo.clear()
    for index in objects:
        pdo.add_variable(index)
    pdo.trans_type, pdo.enabled = kind, True
    pdo.save()
drive.sdo[0x1016][1].raw = MASTER << 16 | WATCHDOG_MS  # it stops when this program does
beat = network.send_periodic(0x700 + MASTER, b"\x05", WATCHDOG_MS / 4000)
drive.setup_402_state_machine()
drive.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
drive.nmt.state = "OPERATIONAL"
network.sync.start(PERIOD_S)


def hold(goal: float) -> float:
    """Command a spring and a damper once, on fresh feedback; return the length from position zero, m."""
    drive.tpdo[2].wait_for_reception(timeout=1.0)
    length = M_PER_COUNT * drive.tpdo[1]["object 6064"].raw
    rate = M_PER_COUNT * drive.tpdo[2]["object 606C"].raw
    drive.rpdo[1]["Target torque"].raw = round((2e4 * (goal - length) - 4e3 * rate) / N_PER_PERMILLE)
    drive.rpdo[1].transmit()
    return length


drive.state = "OPERATION ENABLED"  # its brake opens
start = M_PER_COUNT * drive.tpdo[1]["object 6064"].raw
end, begun = start, time.monotonic()
while (share := (time.monotonic() - begun) / 0.8) < 1.5:
    end = hold(start + 0.02 * min(1.0, share))
print(f"moved by {1e3 * (end - start):.1f} mm")
drive.state = "SWITCH ON DISABLED"  # its brake closes
network.sync.stop()
beat.stop()
network.disconnect()
