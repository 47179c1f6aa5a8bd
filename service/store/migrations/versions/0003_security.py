"""Tokens, and an audit log that is chained by hashes and can only grow."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

from service.store.audit_chain import GENESIS, link

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

REFUSAL = "the audit log is append-only"


def upgrade() -> None:
    """Chain what is there, then forbid to change it."""
    op.create_table(
        "tokens",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("launcher", sa.Text, nullable=False),
        sa.Column("name", sa.Text, nullable=False),
        sa.Column("role", sa.Text, nullable=False),
        sa.Column("secret_hash", sa.Text, nullable=False),
        sa.Column("created_utc", sa.Text, nullable=False),
        sa.Column("expires_utc", sa.Text),
        sa.Column("revoked_utc", sa.Text),
    )
    op.create_table(
        "audit_heads",
        sa.Column("launcher", sa.Text, primary_key=True),
        sa.Column("entries", sa.Integer, nullable=False),
        sa.Column("sha256", sa.Text, nullable=False),
    )
    with op.batch_alter_table("audit") as batch:
        batch.add_column(sa.Column("number", sa.Integer, nullable=False, server_default="0"))
        batch.add_column(sa.Column("sha256", sa.Text, nullable=False, server_default=""))
    _chain()
    if op.get_bind().dialect.name == "sqlite":
        for event in ("UPDATE", "DELETE"):
            op.execute(
                f"CREATE TRIGGER audit_no_{event.lower()} BEFORE {event} ON audit "
                f"BEGIN SELECT RAISE(ABORT, '{REFUSAL}'); END"
            )
    else:
        op.execute(
            "CREATE FUNCTION audit_refuse() RETURNS trigger LANGUAGE plpgsql AS "
            f"$$ BEGIN RAISE EXCEPTION '{REFUSAL}'; END $$"
        )
        op.execute(
            "CREATE TRIGGER audit_append_only BEFORE UPDATE OR DELETE ON audit "
            "FOR EACH ROW EXECUTE FUNCTION audit_refuse()"
        )


def downgrade() -> None:
    """Forget chain and tokens."""
    if op.get_bind().dialect.name == "sqlite":
        op.execute("DROP TRIGGER audit_no_update")
        op.execute("DROP TRIGGER audit_no_delete")
    else:
        op.execute("DROP TRIGGER audit_append_only ON audit")
        op.execute("DROP FUNCTION audit_refuse()")
    with op.batch_alter_table("audit") as batch:
        batch.drop_column("sha256")
        batch.drop_column("number")
    op.drop_table("audit_heads")
    op.drop_table("tokens")


def _chain() -> None:
    connection = op.get_bind()
    heads: dict[str, tuple[int, str]] = {}
    rows = connection.execute(sa.text("SELECT * FROM audit ORDER BY id")).mappings().all()
    for row in rows:
        number, previous = heads.get(row["launcher"], (0, GENESIS))
        heads[row["launcher"]] = number + 1, (digest := link(previous, number + 1, dict(row)))
        values = {"number": number + 1, "sha256": digest, "id": row["id"]}
        connection.execute(sa.text("UPDATE audit SET number = :number, sha256 = :sha256 WHERE id = :id"), values)
    for launcher, (entries, digest) in heads.items():
        values = {"launcher": launcher, "entries": entries, "sha256": digest}
        connection.execute(sa.text("INSERT INTO audit_heads VALUES (:launcher, :entries, :sha256)"), values)
