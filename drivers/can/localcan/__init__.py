"""localcan: a CAN bus between the processes of one machine, with bit time and arbitration.

No broker: the wire is a piece of shared memory under a file lock (`wire`), arbitration is advanced by whoever
looks, and a participant (`participant`) sees a frame when its last bit would have been on a real wire.
`interface.LocalCanBus` is its face to python-can.
"""
