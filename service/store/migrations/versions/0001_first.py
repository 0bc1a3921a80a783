"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    """Make them."""
    op.create_table(
        "telemetry",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), autoincrement=True, nullable=False),
        sa.Column("machine", sa.String(64), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("received_s", sa.Double(), nullable=False),
        sa.Column("sample", sa.Text(), nullable=False, comment="JSON: temperatures and channels"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_telemetry")),
    )
    op.create_index(op.f("ix_telemetry_machine_time_s"), "telemetry", ["machine", "time_s"])
    op.create_table(
        "snapshots",
        sa.Column("machine", sa.String(64), nullable=False),
        sa.Column("saved_s", sa.Double(), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=True, comment="of the newest sample in it; null before the first"),
        sa.Column("model", sa.String(64), nullable=False),
        sa.Column(
            "state",
            sa.Text(),
            nullable=False,
            comment="JSON: thermal state, sensors' tracks, datum, what was served last",
        ),
        sa.PrimaryKeyConstraint("machine", name=op.f("pk_snapshots")),
    )
    op.create_table(
        "models",
        sa.Column("machine", sa.String(64), nullable=False),
        sa.Column("version", sa.String(64), nullable=False),
        sa.Column("origin", sa.String(16), nullable=False, comment="'command-line' or 'upload'"),
        sa.Column("added_s", sa.Double(), nullable=False),
        sa.Column("added_by", sa.String(64), nullable=False),
        sa.Column("active", sa.Boolean(), nullable=False),
        sa.Column(
            "activated_s", sa.Double(), nullable=True, comment="when it became active last; null where it never was"
        ),
        sa.PrimaryKeyConstraint("machine", "version", name=op.f("pk_models")),
    )
    op.create_table(
        "model_files",
        sa.Column("machine", sa.String(64), nullable=False),
        sa.Column("version", sa.String(64), nullable=False),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("content", sa.LargeBinary(), nullable=False),
        sa.PrimaryKeyConstraint("machine", "version", "name", name=op.f("pk_model_files")),
    )
    op.create_table(
        "measurements",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("machine", sa.String(64), nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("received_s", sa.Double(), nullable=False),
        sa.Column("model", sa.String(64), nullable=False),
        sa.Column(
            "body",
            sa.Text(),
            nullable=False,
            comment="JSON: position, measured and predicted deviation, uncertainty",
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_measurements")),
    )
    op.create_index(op.f("ix_measurements_machine_time_s"), "measurements", ["machine", "time_s"])
    op.create_table(
        "keys",
        sa.Column("id", sa.String(16), nullable=False, comment="the key's public part"),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("role", sa.String(16), nullable=False),
        sa.Column("hash", sa.String(64), nullable=False, comment="SHA-256 of the secret part, hexadecimal"),
        sa.Column("created_s", sa.Double(), nullable=False),
        sa.Column("revoked_s", sa.Double(), nullable=True),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_keys")),
    )
    op.create_table(
        "audit",
        sa.Column("id", sa.Integer(), autoincrement=True, nullable=False),
        sa.Column("time_s", sa.Double(), nullable=False),
        sa.Column("who", sa.String(64), nullable=False, comment="name of the key, 'anyone' without keys, or 'service'"),
        sa.Column("machine", sa.String(64), nullable=True),
        sa.Column("action", sa.String(64), nullable=False),
        sa.Column("detail", sa.Text(), nullable=False, comment="JSON"),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_audit")),
    )
    op.create_index(op.f("ix_audit_time_s"), "audit", ["time_s"])
    op.create_table(
        "journal",
        sa.Column("id", sa.Integer(), autoincrement=False, nullable=False, comment="always 1"),
        sa.Column("writer", sa.String(32), nullable=False, comment="the process that wrote last"),
        sa.Column(
            "batch", sa.BigInteger(), nullable=False, comment="its newest transaction, so that none is written twice"
        ),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_journal")),
    )
