"""Our own protocol, defined by legs.dbc: codec, both ends, compiled."""
