"""Codec of the project's own drive protocol `legs`, defined by legs.dbc: the controller's end, compiled."""
