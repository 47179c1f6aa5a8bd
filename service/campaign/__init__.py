"""Monte Carlo studies and re-analyses of whole fleets on many workers (docs/campaigns.md)."""

from __future__ import annotations

from service.campaign.engine import CampaignFailed, run_campaign
from service.campaign.spec import Campaign, read_campaign

__all__ = ["Campaign", "CampaignFailed", "read_campaign", "run_campaign"]
