"""Codec of the project's own protocol `legs`, defined by legs.dbc: the controller's end, compiled."""
