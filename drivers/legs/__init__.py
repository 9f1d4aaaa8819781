"""Our own protocol, defined by legs.dbc: the controller's end, compiled."""
