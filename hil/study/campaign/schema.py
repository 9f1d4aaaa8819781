"""The JSON Schema of a campaign file, for editors; it is committed beside the shipped campaigns."""

import json

from hil.app.configuration.schema import described
from hil.study.campaign.settings import CampaignSettings


def text() -> str:
    """Return the schema as the committed file has it."""
    schema = described(
        CampaignSettings.__name__, CampaignSettings.model_json_schema(), "hexapod-hil campaign"
    )
    return json.dumps(schema, indent=1, ensure_ascii=False) + "\n"
