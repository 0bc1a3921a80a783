"""The error map as it goes over the wire: all that a client needs to compensate by itself."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from service.schemas import MAX_TOOL_LENGTH_MM, Datum, Header, LimitsInfo
from service.timestamps import QueryTimestamp

Triple = tuple[float, float, float]


class MapQuery(BaseModel):
    """When, and for which tool."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    time: QueryTimestamp | None = Field(None, description="Default: the service's clock.")
    tool_length_mm: Annotated[float, Field(ge=0, le=MAX_TOOL_LENGTH_MM, allow_inf_nan=False)] | None = Field(
        None, description="The longest tool that the map is used with, for the rate limit. Default: the machine's own."
    )


class BodyInfo(BaseModel):
    """One body of the machine; bodies stand behind their lower bodies, the bed first."""

    name: str
    lower: str | None = Field(None, description="The body that carries it; null for the bed.")
    axis: str | None = Field(None, description="The axis that moves it; null for a fixed body.")
    motion_terms: list[str] = Field(description="Names in the order x, y, z, a, b, c of ΔM; empty without an axis.")
    location_terms: list[str] = Field(description="The same of ΔF; empty where it has none.")


class AxisGeometry(BaseModel):
    """One axis."""

    range_mm: tuple[float, float]
    origin_mm: Triple = Field(description="Its body's origin in the lower body's frame at coordinate 0.")
    direction: Triple = Field(description="In which its body moves when the coordinate grows.")


class ToolInfo(BaseModel):
    """The tool."""

    body: str = Field(description="The body that carries it.")
    offset_mm: Triple = Field(description="Its tip in that body's frame, where no tool length is named.")
    direction: Triple = Field(description="Of a tool of another length: the tip is at length times this.")


class ErrorTables(BaseModel):
    """Values of all error terms."""

    knots_mm: dict[str, list[float]] = Field(description="Per axis, where its motion terms are tabulated; rising.")
    motion_um: dict[str, list[float]] = Field(description="Per linear motion term, its values at its axis' knots.")
    motion_urad: dict[str, list[float]] = Field(description="The same of the angular ones.")
    location_um: dict[str, float] = Field(description="Linear location terms.")
    location_urad: dict[str, float] = Field(description="Angular location terms.")


_TABLES = {
    "knots_mm": {"X": [0.0, 400.0, 800.0]},
    "motion_um": {"EXX": [0.0, 6.0, 12.0], "EYX": [0.0, 3.0, 3.0], "EZX": [0.0, 0.0, 0.0]},
    "motion_urad": {"EAX": [0.0, 0.0, 0.0], "EBX": [0.0, 2.0, 4.0], "ECX": [0.0, 0.0, 0.0]},
    "location_um": {"EX0X": 0.0, "EY0X": 0.0, "EZ0X": 0.0},
    "location_urad": {"EA0X": 0.0, "EB0X": -20.0, "EC0X": 0.0},
}
# Keys that would be null are left out, as the framework leaves them out of its description.
_EXAMPLE: dict[str, Any] = {
    "machine": "mill",
    "time": "2026-01-31T08:00:00Z",
    "model": "81813f9bb424",
    "status": "ok",
    "warnings": [],
    "version": "5f0c1d2e3a4b5968",
    "valid_until": "2026-01-31T08:09:30Z",
    "datum": {"kind": "set", "time": "2026-01-31T07:10:00Z"},
    "composition": "motion-last",
    "structure": [
        {"name": "bed", "motion_terms": [], "location_terms": []},
        {
            "name": "X",
            "lower": "bed",
            "axis": "X",
            "motion_terms": ["EXX", "EYX", "EZX", "EAX", "EBX", "ECX"],
            "location_terms": ["EX0X", "EY0X", "EZ0X", "EA0X", "EB0X", "EC0X"],
        },
    ],
    "workpiece_body": "X",
    "tool": {"body": "bed", "offset_mm": [0.0, 0.0, -100.0], "direction": [0.0, 0.0, -1.0]},
    "axes": {"X": {"range_mm": [0.0, 800.0], "origin_mm": [0.0, 0.0, 0.0], "direction": [-1.0, 0.0, 0.0]}},
    "limits": {"max_correction_um": 300.0, "max_rate_um_per_min": 60.0},
    "remaining_um": 0.0,
    "served": _TABLES,
}


class MapReply(Header):
    """The error map, and the machine that it belongs to."""

    warnings: list[str]
    version: str = Field(description="Changes with anything here but time and warnings; also the ETag.")
    valid_until: str | None = Field(
        None,
        description="Until when it may be used if no newer one can be fetched: then the telemetry in it is stale, and "
        "the service would fade it out. Null for a map that telemetry has no part in.",
    )
    datum: Datum
    composition: Literal["motion-last", "seed"]
    structure: list[BodyInfo]
    workpiece_body: str = Field(description="The body that carries the workpiece.")
    tool: ToolInfo
    axes: dict[str, AxisGeometry]
    limits: LimitsInfo
    remaining_um: float = Field(description="How far a correction may still be from that of the target.")
    served: ErrorTables = Field(description="What corrections are computed from now: the map to use.")
    target: ErrorTables | None = Field(
        None,
        description="What the served map moves to at no more than `max_rate_um_per_min`; null once it is there, or "
        "while the prediction is not usable.",
    )

    model_config = ConfigDict(json_schema_extra={"examples": [_EXAMPLE]})
