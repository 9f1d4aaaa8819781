"""Fixtures for CAN FMUs."""

import pytest

from plant_fmu.network.node import Node
from plant_fmu.network.terminal import read_can_fmu
from tests.network.can_nodes import build_node


@pytest.fixture
def hosted(tmp_path):
    """Function that builds a CAN FMU and hosts it until the test ends; arguments as `build_node`."""
    opened = []

    def host(identifier, **settings):
        node = Node(read_can_fmu(build_node(tmp_path, identifier, **settings)), f"{identifier:X}")
        opened.append(node)
        return node

    yield host
    for node in opened:
        node.close()
