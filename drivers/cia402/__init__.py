"""CiA 402 drives over CANopen: cyclic synchronous torque by SYNC and PDO, set-up by SDO."""
