"""The family of the page on drive families runs in a simulation and passes the contract suite."""

import re

import pytest

from tests.docs.page_package import CONTRACT, SUCCESS, Package

SAME = """
import numpy as np
from cheetah.codec import CheetahProtocol
from drivers.config import BusSettings, DriveSettings, TransmissionSettings
from drivers.mit import mit
from drivers.protocol import Frame

bus, gear = BusSettings(layout="classic"), TransmissionSettings(lead_m=0.01)
one = CheetahProtocol(bus, DriveSettings(protocol="cheetah", transmission=gear, force_limit_N=5000))
options = {"variant": "mini_cheetah"}
other = mit(
    bus, DriveSettings(protocol="mit", transmission=gear, force_limit_N=5000, options=options)
)
assert one.requests(1.0) == other.requests(1.0)
assert one.torque_limit == other.torque_limit
for seed in range(300):
    data = np.random.default_rng(seed).bytes(5)
    frame = Frame(0, bytes((1 + seed % 6,)) + data)
    assert one._heard(frame) == other._heard(frame)
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return Package("protocol", "cheetah", "own-drives.md", tmp_path_factory.mktemp("page"))


def test_the_family_of_the_page_runs_to_parked_and_replays(package):
    package.run(package.blocks["simulation"] + SUCCESS)


def test_the_family_of_the_page_passes_the_contract_suite(package):
    assert re.search(r"^\d\d passed", package.run(CONTRACT), re.MULTILINE)


def test_the_family_of_the_page_speaks_as_the_variant_of_mit_does(package):
    package.run(SAME)
