"""The database's tables, the same for SQLite and PostgreSQL; `migrations/` brings a database to them.

Times are epoch seconds in UTC. JSON is kept as text: Python writes floats so that they come back bit for bit.
"""

from __future__ import annotations

from sqlalchemy import BigInteger, Boolean, Column, Double, Index, Integer, LargeBinary, MetaData, String, Table, Text

metadata = MetaData(
    naming_convention={"ix": "ix_%(table_name)s_%(column_0_N_name)s", "pk": "pk_%(table_name)s"},
)

telemetry = Table(
    "telemetry",
    metadata,
    Column("id", BigInteger().with_variant(Integer, "sqlite"), primary_key=True, autoincrement=True),
    Column("machine", String(64), nullable=False),
    Column("time_s", Double, nullable=False),
    Column("received_s", Double, nullable=False),
    Column("sample", Text, nullable=False, comment="JSON: temperatures and channels"),
    Index(None, "machine", "time_s"),
)

snapshots = Table(
    "snapshots",
    metadata,
    Column("machine", String(64), primary_key=True),
    Column("saved_s", Double, nullable=False),
    Column("time_s", Double, nullable=True, comment="of the newest sample in it; null before the first"),
    Column("model", String(64), nullable=False),
    Column("state", Text, nullable=False, comment="JSON: thermal state, sensors' tracks, datum, what was served last"),
)

models = Table(
    "models",
    metadata,
    Column("machine", String(64), primary_key=True),
    Column("version", String(64), primary_key=True),
    Column("origin", String(16), nullable=False, comment="'command-line' or 'upload'"),
    Column("added_s", Double, nullable=False),
    Column("added_by", String(64), nullable=False),
    Column("active", Boolean, nullable=False),
    Column("activated_s", Double, nullable=True, comment="when it became active last; null where it never was"),
)

model_files = Table(
    "model_files",
    metadata,
    Column("machine", String(64), primary_key=True),
    Column("version", String(64), primary_key=True),
    Column("name", String(64), primary_key=True),
    Column("content", LargeBinary, nullable=False),
)

measurements = Table(
    "measurements",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("machine", String(64), nullable=False),
    Column("time_s", Double, nullable=False),
    Column("received_s", Double, nullable=False),
    Column("model", String(64), nullable=False),
    Column("body", Text, nullable=False, comment="JSON: position, measured and predicted deviation, uncertainty"),
    Index(None, "machine", "time_s"),
)

keys = Table(
    "keys",
    metadata,
    Column("id", String(16), primary_key=True, comment="the key's public part"),
    Column("name", String(64), nullable=False),
    Column("role", String(16), nullable=False),
    Column("hash", String(64), nullable=False, comment="SHA-256 of the secret part, hexadecimal"),
    Column("created_s", Double, nullable=False),
    Column("revoked_s", Double, nullable=True),
)

audit = Table(
    "audit",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=True),
    Column("time_s", Double, nullable=False),
    Column("who", String(64), nullable=False, comment="name of the key, 'anyone' without keys, or 'service'"),
    Column("machine", String(64), nullable=True),
    Column("action", String(64), nullable=False),
    Column("detail", Text, nullable=False, comment="JSON"),
    Index(None, "time_s"),
)

journal = Table(
    "journal",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False, comment="always 1"),
    Column("writer", String(32), nullable=False, comment="the process that wrote last"),
    Column("batch", BigInteger, nullable=False, comment="its newest transaction, so that none is written twice"),
)
