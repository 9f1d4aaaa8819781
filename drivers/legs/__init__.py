"""Our own protocol, told by legs.dbc: codec, both ends, compiled."""
