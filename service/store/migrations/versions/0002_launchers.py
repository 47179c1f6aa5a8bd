"""Who wrote it, where many launchers share one store; an idempotency key holds at one launcher."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None

BEFORE = "launcher"
"""Name under which stores of one launcher were written, the default of ``[store] launcher``."""


def upgrade() -> None:
    """Name the launcher."""
    for table in ("runs", "transitions", "audit"):
        with op.batch_alter_table(table) as batch:
            batch.add_column(sa.Column("launcher", sa.Text, nullable=False, server_default=BEFORE))
    op.create_index("runs_by_launcher", "runs", ["launcher", "id"])
    op.create_index("transitions_by_launcher", "transitions", ["launcher", "id"])
    op.rename_table("idempotency_keys", "old_keys")
    _make_keys(sa.Column("launcher", sa.Text, primary_key=True))
    op.execute(
        "INSERT INTO idempotency_keys (launcher, key, utc, request_sha256, run_id) "
        f"SELECT '{BEFORE}', key, utc, request_sha256, run_id FROM old_keys"
    )
    op.drop_table("old_keys")


def downgrade() -> None:
    """Forget the launchers; of a key that several used, the first use is kept."""
    op.rename_table("idempotency_keys", "old_keys")
    _make_keys()
    op.execute(
        "INSERT INTO idempotency_keys (key, utc, request_sha256, run_id) "
        "SELECT key, utc, request_sha256, run_id FROM old_keys "
        "WHERE NOT EXISTS (SELECT 1 FROM old_keys AS other WHERE other.key = old_keys.key AND "
        "(other.utc < old_keys.utc OR (other.utc = old_keys.utc AND other.launcher < old_keys.launcher)))"
    )
    op.drop_table("old_keys")
    op.drop_index("transitions_by_launcher", "transitions")
    op.drop_index("runs_by_launcher", "runs")
    for table in ("audit", "transitions", "runs"):
        with op.batch_alter_table(table) as batch:
            batch.drop_column("launcher")


def _make_keys(*launcher: sa.Column[str]) -> None:
    # The constraints are named: PostgreSQL's own names would stay with the table that was renamed.
    suffix = "by_launcher" if launcher else "of_all"
    columns = [column.name for column in launcher]
    op.create_table(
        "idempotency_keys",
        *(sa.Column(column.name, sa.Text, nullable=False) for column in launcher),
        sa.Column("key", sa.Text, nullable=False),
        sa.Column("utc", sa.Text, nullable=False),
        sa.Column("request_sha256", sa.Text, nullable=False),
        sa.Column("run_id", sa.Text, sa.ForeignKey("runs.id"), nullable=False),
        sa.PrimaryKeyConstraint(*columns, "key", name=f"idempotency_keys_{suffix}"),
    )
