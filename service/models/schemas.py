"""What `/v1/machines/{name}/models` answers."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field


class ModelInfo(BaseModel):
    """A model of a machine."""

    version: str = Field(description="First twelve digits of the manifest's digest, which covers all files.")
    origin: Literal["command-line", "upload"]
    added: str = Field(description="When, RFC 3339.")
    added_by: str = Field(description="Name of the key; 'service' for a bundle of the command line.")
    active: bool = Field(description="Whether the machine is served with it now.")
    activated: str | None = Field(description="When it became active last; null where it never was.")
    kept: bool = Field(description="Whether its files are in the database, so that it can be activated again.")
    training: dict[str, Any] = Field(description="Data, runs and settings that made it, from its manifest.")
    test: dict[str, Any] = Field(description="Residuals on what was left out of training, from its manifest.")


class ModelsReply(BaseModel):
    """All models of a machine, newest first."""

    machine: str
    models: list[ModelInfo]


class ModelReply(BaseModel):
    """One model, after something was done with it."""

    machine: str
    model: ModelInfo
    warnings: list[str] = Field(description="What is not as before, such as a datum that could not be made anew.")
