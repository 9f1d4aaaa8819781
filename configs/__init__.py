"""Shipped configurations, as data; a package so that an installed wheel finds them."""
