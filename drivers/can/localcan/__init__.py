"""localcan: a CAN bus between the processes of one machine, with bit time and arbitration.

No broker and no lock: the wire is a piece of shared memory (`wire`), whoever looks advances the arbitration
(`log`), and a participant (`participant`) sees a frame when its last bit would have been on a real wire. Its
time is that of `bench_clock`, which can stand still.
`interface.LocalCanBus` is its face to python-can.
"""
