"""What survives a restart: telemetry, snapshots, models, measurements, keys and the audit trail, in one database."""
