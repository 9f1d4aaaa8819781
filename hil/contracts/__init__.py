"""Contract suites for laws, drive protocols and sensors, ours and those of other packages.

A test class inherits one: `hil.contracts.law.LawContract`, `hil.contracts.trouble.TroubleContract`,
`hil.contracts.sensor.SensorContract`. pytest loads this file through an entry point, so that assertions in
the suites show their values.
"""

import pytest

pytest.register_assert_rewrite(
    "hil.contracts.law", "hil.contracts.protocol", "hil.contracts.sensor", "hil.contracts.trouble"
)


def pytest_configure(config: pytest.Config) -> None:
    """Declare the pytest marker `long` of the suites' slow tests."""
    config.addinivalue_line("markers", 'long: takes a while; leave it out with -m "not long"')
