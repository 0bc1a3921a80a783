"""What `/measurements` takes and answers. The units are in the names."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from service.schemas import Body, Header, Name, Number, ToolRequest
from service.timestamps import QueryTimestamp, Timestamp

MAX_MEASUREMENTS_PER_REQUEST = 100
"""A probing cycle has some dozens. Their comparison takes about 0.1 s of one core, which other requests wait for."""
MAX_LISTED = 1000
LARGEST_UM = 1e6
"""A probed deviation of a metre is one in other units."""

Micrometres = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST_UM, le=LARGEST_UM)]


class Deviation(Body):
    """Actual minus nominal, in the workpiece frame; at least one component."""

    x: Micrometres | None = None
    y: Micrometres | None = None
    z: Micrometres | None = None

    @model_validator(mode="after")
    def _has_one(self) -> Self:
        if self.x is None and self.y is None and self.z is None:
            raise ValueError("must have at least one of x, y and z")
        return self


class Measurement(Body):
    """A probed deviation."""

    time: Timestamp
    position: dict[Name, Number] = Field(description="Programmed coordinate of every axis [mm].")
    deviation_um: Deviation
    uncertainty_um: Annotated[float, Field(ge=0, le=LARGEST_UM, allow_inf_nan=False)] | None = Field(
        None, description="Half of the probing's own 95 % interval. Default: 2 µm."
    )
    compensated: bool = Field(False, description="Whether the correction was active, so that this is what it left.")
    tool: ToolRequest | None = Field(None, description="The probe. Default: the tool of the machine description.")


class MeasurementsRequest(Body):
    """Probed deviations, in any order."""

    measurements: Annotated[list[Measurement], Field(min_length=1, max_length=MAX_MEASUREMENTS_PER_REQUEST)]


class MeasurementsQuery(BaseModel):
    """How many to list."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    limit: Annotated[int, Field(ge=1, le=MAX_LISTED)] = 100
    since: QueryTimestamp | None = Field(None, description="The earliest to list.")


class PartialVector(BaseModel):
    """In the workpiece frame; null where not measured or not known."""

    x: float | None
    y: float | None
    z: float | None


class MeasurementReply(BaseModel):
    """A measurement beside the prediction of its moment."""

    time: str
    model: str = Field(description="Version of the bundle that predicted.")
    position: dict[str, float]
    deviation_um: PartialVector
    compensated: bool
    predicted_um: PartialVector | None = Field(
        description="What the prediction would have measured; null where that is not known."
    )
    residual_um: PartialVector | None = Field(description="Measured minus predicted.")
    interval_um: float | None = Field(
        description="Half the width of the 95 % interval of each component of the residual; null where not known."
    )
    note: str | None = Field(description="Why it was not compared, or does not count for drift.")


class DriftReply(BaseModel):
    """What the probed deviations of the present model say of the machine.

    The residual is less what it was at the same place in its first eight sessions; probings within four hours are one.
    """

    drifting: bool
    running_residual_um: PartialVector = Field(description="Weighted mean of the newest sessions; null until known.")
    limit_um: PartialVector = Field(
        description="What it stays within in all but 0.1 % of sessions, unless the machine drifts."
    )
    trend_um_per_day: PartialVector
    trend_standard_error_um_per_day: PartialVector
    sessions: int


class MeasurementsReply(Header):
    """Measurements, and what all of them say."""

    warnings: list[str]
    drift: DriftReply
    measurements: list[MeasurementReply]
