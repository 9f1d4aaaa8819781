"""CAN FMUs: network FMUs of the FMI layered standard FMI-LS-BUS 1.0, on a simulated or a real CAN bus.

`operations` is the codec of the bus protocol, `terminal` reads the variables of an FMU's buses, `node`
hosts one FMU in event mode, `station` makes it a participant. `shared_bus` is the bus in lockstep,
`attached` puts the FMUs on a CAN interface. `drives` has CAN FMUs as drives in front of a plant.
"""
