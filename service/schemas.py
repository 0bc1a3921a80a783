"""What goes over the wire: request bodies, checked here, and replies. The units are in the names."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

from service.status import Status
from service.timestamps import QueryTimestamp, Timestamp

MAX_POSITIONS_PER_REQUEST = 2000
"""Their correction takes about 0.1 s of one core, which other requests wait for."""
MAX_EXPLAINED_PER_REQUEST = 100
"""Each has up to a kilobyte for each of 20 terms, and a client that wants more wants `/errors` or `/map`."""
MAX_SAMPLES_PER_REQUEST = 4000
"""An hour at one a second with room to spare; the network steps through them in about half a second."""
MAX_TOOL_LENGTH_MM = 2000.0
"""Longer than any tool. A length given in µm by mistake would slow the rate limit down for good."""

Name = Annotated[str, StringConstraints(max_length=64)]
"""An axis, sensor or channel. No name is longer; a longer one is not looked up."""
Number = Annotated[float, Field(allow_inf_nan=False)]
Temperature = Annotated[float | None, Field(description="Reading [°C]; null where there is none.")]


class Body(BaseModel):
    """A request body: refuses unknown keys, and text in place of numbers."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class Sample(Body):
    """One telemetry sample."""

    time: Timestamp
    temperatures: dict[Name, Temperature]
    channels: dict[Name, Number] = Field(default_factory=dict, description="Other inputs, such as spindle_rpm.")


class TelemetryRequest(Body):
    """Telemetry samples, in any order."""

    samples: Annotated[list[Sample], Field(min_length=1, max_length=MAX_SAMPLES_PER_REQUEST)]


class ToolRequest(Body):
    """The tool in the spindle."""

    length_mm: Annotated[float, Field(ge=0, le=MAX_TOOL_LENGTH_MM, allow_inf_nan=False)]


class CompensateRequest(Body):
    """Programmed positions, and optionally the tool, the time and a telemetry sample."""

    positions: Annotated[list[dict[Name, Number]], Field(min_length=1, max_length=MAX_POSITIONS_PER_REQUEST)]
    tool: ToolRequest | None = Field(None, description="Default: the tool of the machine description.")
    time: Timestamp | None = Field(None, description="Default: the service's clock.")
    temperatures: dict[Name, Temperature] | None = Field(None, description="Counts as a telemetry sample first.")
    channels: dict[Name, Number] | None = Field(None, description="Goes with `temperatures`.")


class CompensateQuery(BaseModel):
    """How much to answer."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    explain: bool = Field(
        False,
        description=f"Add to each of at most {MAX_EXPLAINED_PER_REQUEST} points the share of each error term.",
    )
    tool_length_mm: Annotated[float, Field(ge=0, le=MAX_TOOL_LENGTH_MM, allow_inf_nan=False)] | None = Field(
        None, description="With an Arrow stream, which has no place for a tool; JSON has its own."
    )


class ErrorsQuery(BaseModel):
    """Positions as one list per axis, all of one length; without any, the map's own grid."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    X: list[Number] | None = None
    Y: list[Number] | None = None
    Z: list[Number] | None = None
    U: list[Number] | None = None
    V: list[Number] | None = None
    W: list[Number] | None = None
    A: list[Number] | None = None
    B: list[Number] | None = None
    C: list[Number] | None = None
    time: QueryTimestamp | None = Field(None, description="Default: the service's clock.")


class Header(BaseModel):
    """What every reply about a machine starts with."""

    machine: str
    time: str = Field(description="The machine's clock, RFC 3339.")
    model: str = Field(description="Version of the bundle that answered.")
    status: Status


class TelemetryReply(Header):
    """What became of the samples."""

    accepted: int = Field(description="Samples that the thermal state has taken in.")
    ignored: int = Field(description="Samples no newer than the state, or of no use to this machine.")
    warnings: list[str]


class Vector(BaseModel):
    """In the workpiece frame."""

    x: float
    y: float
    z: float


class Share(BaseModel):
    """A part of a deviation: what comes from measured geometric errors, and what from warmth, as it counts."""

    geometric_um: Vector
    thermal_um: Vector


class TermShare(BaseModel):
    """One error term's part of a deviation."""

    term: str
    geometric_um: Vector
    thermal_um: Vector


class Explanation(BaseModel):
    """Why a deviation is what it is. All shares and `second_order_um` add up to `deviation_um`."""

    terms: list[TermShare] = Field(
        description="To first order, the largest first; those with neither part above 0.001 µm are among the others."
    )
    others: Share
    second_order_um: Vector = Field(description="What the exact chain adds to the first order.")

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "terms": [
                        {
                            "term": "EZ0T",
                            "geometric_um": {"x": 0.0, "y": 0.0, "z": 0.0},
                            "thermal_um": {"x": 0.0, "y": 0.0, "z": -40.0},
                        },
                        {
                            "term": "EXX",
                            "geometric_um": {"x": -6.0, "y": 0.0, "z": 0.0},
                            "thermal_um": {"x": -8.0, "y": 0.0, "z": 0.0},
                        },
                    ],
                    "others": {
                        "geometric_um": {"x": 0.0002, "y": 0.0, "z": 0.0},
                        "thermal_um": {"x": 0.0, "y": 0.0, "z": 0.0},
                    },
                    "second_order_um": {"x": -0.0003, "y": 0.0001, "z": 0.0},
                }
            ]
        }
    )


class Point(BaseModel):
    """One position's answer."""

    corrected: dict[str, float] = Field(description="Coordinates to command [mm].")
    correction: dict[str, float] = Field(description="Corrected minus programmed [mm].")
    deviation_um: Vector = Field(
        description="Where the tip would be, less where it should be, at the programmed position; not limited."
    )
    uncertainty_um: float | None = Field(
        None,
        description="Half the width of the 95 % interval of the largest component of `deviation_um`; not there where "
        "the bundle does not say how far predictions may be off, or the thermal part does not count.",
    )
    limited: bool = Field(description="The rate or the absolute limit holds the correction back.")
    explanation: Explanation | None = Field(None, description="Only with `?explain=true`.")


class CompensateReply(Header):
    """Corrected coordinates, in the order of the positions."""

    reliability: float = Field(description="How much of the thermal part counts, 0 ... 1.")
    warnings: list[str]
    points: list[Point]


class TermErrors(BaseModel):
    """One error term; its lists run over `at_mm`, or over the positions asked for."""

    term: str
    unit: Literal["um", "urad"]
    axis: str | None = Field(description="The axis it is a function of; null for a location term.")
    at_mm: list[float] | None = Field(description="Positions on that axis; null for a location term.")
    geometric: list[float]
    thermal: list[float] = Field(description="After datum and weight, as it counts in the total.")
    total: list[float]


class ErrorsReply(Header):
    """Error terms predicted now: what the correction is on its way to."""

    warnings: list[str]
    reliability: float = Field(description="How much of the thermal part counts, 0 ... 1.")
    terms: list[TermErrors]


class Datum(BaseModel):
    """What thermal displacements are measured against."""

    kind: Literal["absolute", "run-start", "set"]
    time: str | None = Field(description="When that state was; null for absolute, or before the first sample.")


class DatumReply(Header):
    """The datum in force."""

    datum: Datum


class AxisInfo(BaseModel):
    """One axis."""

    range_mm: tuple[float, float]


class SensorInfo(BaseModel):
    """One sensor."""

    range_degC: tuple[float, float]
    max_rate_degC_per_min: float
    used: bool = Field(description="Whether the network reads it.")
    valid_range_degC: tuple[float, float] | None = Field(description="Temperatures the network was trained on.")
    taken_degC: float | None = Field(
        description="What the network took last: the reading, or its estimate; null before the first, or if not used."
    )
    fault: str | None = Field(description="Why its last reading was replaced; null for a good one.")


class TermInfo(BaseModel):
    """One error term."""

    term: str
    unit: Literal["um", "urad"]
    kind: Literal["motion", "location"]
    axis: str | None


class LimitsInfo(BaseModel):
    """Bounds of the correction."""

    max_correction_um: float
    max_rate_um_per_min: float


class MachineReply(Header):
    """What is served for one machine."""

    warnings: list[str]
    axes: dict[str, AxisInfo]
    tool_offset_mm: tuple[float, float, float]
    sensors: dict[str, SensorInfo]
    channels: list[str]
    terms: list[TermInfo]
    limits: LimitsInfo
    datum: Datum
    telemetry_time: str | None = Field(description="Of the newest sample; null before the first.")
    correction_um: float | None = Field(
        description="Largest correction on any axis, at the corners and the middle of the working volume, as served "
        "last; null before the first."
    )
    remaining_um: float | None = Field(description="At most so far from where it moves to; null before the first.")
    reliability: float = Field(description="How much of the thermal part counts, 0 ... 1.")


class MachinesReply(BaseModel):
    """All machines."""

    machines: list[MachineReply]


class HealthReply(BaseModel):
    """Liveness."""

    status: Literal["ok"]


class ReadyReply(BaseModel):
    """Readiness."""

    status: Literal["ready"]
    storage: Literal["ok"] = Field(description="The database takes writes.")


class AuditQuery(BaseModel):
    """How much to answer."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    limit: int = Field(100, ge=1, le=1000, description="How many entries at most.")


class AuditEntry(BaseModel):
    """One change."""

    time: str
    who: str = Field(description="Name of the key, `anyone` where keys are off, or `service`.")
    action: str
    machine: str | None = Field(description="null where it concerns the whole service.")
    detail: dict[str, Any]


class AuditReply(BaseModel):
    """What was changed, newest first."""

    machine: str
    entries: list[AuditEntry]
