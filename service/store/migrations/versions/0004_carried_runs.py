"""Runs that came from other stores in bundles."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make the table."""
    op.create_table(
        "carried_runs",
        sa.Column("run_id", sa.Text, sa.ForeignKey("runs.id"), primary_key=True),
        sa.Column("utc", sa.Text, nullable=False),
        sa.Column("signer", sa.Text, nullable=False),
        sa.Column("manifest_sha256", sa.Text, nullable=False),
        sa.Column("audit", sa.Text, nullable=False),
    )


def downgrade() -> None:
    """Forget where runs came from; the runs themselves stay."""
    op.drop_table("carried_runs")
