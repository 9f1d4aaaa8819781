"""Settings of a live reference for tests."""

from typing import Any

LIVE_REFERENCE: dict[str, Any] = {
    "type": "live",
    "limits": {
        "velocity_m_s": 0.3,
        "velocity_deg_s": 20,
        "acceleration_m_s2": 1,
        "acceleration_deg_s2": 60,
        "jerk_m_s3": 10,
        "jerk_deg_s3": 600,
    },
}
