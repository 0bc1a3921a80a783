"""Logging: one JSON object a line on stderr, for events and not for requests."""

from __future__ import annotations

import json
import logging
import logging.config

from service.access.keys import without_keys
from service.request_id import current
from service.timestamps import format_time

_USUAL = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "color_message", "taskName"}


class JsonLines(logging.Formatter):
    """One JSON object a line: time, level, event, the id of the request it belongs to, and what the event carries."""

    def format(self, record: logging.LogRecord) -> str:
        """Return the line."""
        line = {
            "time": format_time(record.created),
            "level": record.levelname.lower(),
            "event": record.getMessage(),
        }
        request_id = current()
        if request_id is not None:
            line["request_id"] = request_id
        line |= {key: value for key, value in vars(record).items() if key not in _USUAL}
        if record.exc_info:
            line["traceback"] = self.formatException(record.exc_info)
        return without_keys(json.dumps(line, default=str))  # somebody may put a key where none belongs: into a path


def configure(level: str, *, access: bool) -> None:
    """Log the service's own events from `level` on, the server's only where something is wrong."""
    logging.config.dictConfig(
        {
            "version": 1,
            "disable_existing_loggers": False,
            "formatters": {"json": {"()": JsonLines}},
            "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "json"}},
            "root": {"level": "WARNING", "handlers": ["stderr"]},
            "loggers": {
                "service": {"level": level.upper()},
                "uvicorn.access": {"level": "INFO" if access else "WARNING"},
            },
        }
    )
