"""A machine description: what TOML says of a machine tool, checked once, then immutable."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, field
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from model.exceptions import MachineError
from model.structure import AXES, ROTARY_AXES, Body, BodyEntry, Layout, lay_out, parse_structure
from model.terms import Term, canonical_name, location_terms, motion_terms
from model.validation import Strict, check, did_you_mean

Triple = tuple[float, float, float]
Interval = tuple[float, float]

UNIT_VECTORS: dict[str, Triple] = {
    "X": (1.0, 0.0, 0.0),
    "Y": (0.0, 1.0, 0.0),
    "Z": (0.0, 0.0, 1.0),
    "U": (1.0, 0.0, 0.0),
    "V": (0.0, 1.0, 0.0),
    "W": (0.0, 0.0, 1.0),
    "A": (1.0, 0.0, 0.0),
    "B": (0.0, 1.0, 0.0),
    "C": (0.0, 0.0, 1.0),
}
"""Direction of each linear axis, and the line that each rotary axis turns about (ISO 841)."""


class Sensor(Strict):
    """Bounds of a plausible reading.

    The default bounds are those of a machine hall and of a sensor on a part that is heated by friction: chosen,
    not measured.
    """

    range_degC: Interval = (-20.0, 120.0)
    max_rate_degC_per_min: Annotated[float, Field(gt=0)] = 20.0


class Limits(Strict):
    """Bounds of the correction.

    Always there: a machine description without them gets these. 300 µm is three times the largest drift usually
    reported, 60 µm/min ten times its usual rate (chosen).
    """

    max_correction_um: Annotated[float, Field(gt=0)] = 300.0
    max_rate_um_per_min: Annotated[float, Field(gt=0)] = 60.0


class Tool(Strict):
    """The tool leaf.

    Attributes
    ----------
    offset_mm : tool tip in the tool frame when a request names no tool length
    direction : unit vector from the spindle nose to the tip, in the tool frame; a request's tool length L puts
        the tip at L times this (a 120 mm tool with [0, 0, -1] has its tip 120 mm below the nose)
    errors : whether the tool holder has location errors EX0T ... EC0T
    """

    offset_mm: Triple = (0.0, 0.0, 0.0)
    direction: Triple = (0.0, 0.0, -1.0)
    errors: bool = False


class Workpiece(Strict):
    """The workpiece leaf; `errors` gives the fixture location errors EX0W ... EC0W."""

    errors: bool = False


class _AxisFile(Strict):
    range: Interval
    origin_mm: Triple = (0.0, 0.0, 0.0)
    direction: Triple | None = None


class _BodyFile(Strict):
    name: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_-]{0,31}$")]
    lower: str | None = None
    axis: str | None = None


class _MachineFile(Strict):
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$")]
    structure: str | None = None
    workpiece_axes: Annotated[int, Field(ge=0)] | None = None
    bodies: list[_BodyFile] | None = None
    composition: Literal["motion-last", "seed"] = "motion-last"
    reference_temperature_degC: Annotated[float, Field(ge=-20, le=60)] = 20.0
    axes: dict[str, _AxisFile]
    tool: Tool = Tool()
    workpiece: Workpiece = Workpiece()
    sensors: dict[str, Sensor] = Field(default_factory=dict)
    limits: Limits = Limits()


@dataclass(frozen=True)
class Axis:
    """One axis.

    Attributes
    ----------
    low, high : range of its coordinate [mm, degree]
    origin_mm : its body's origin in the lower body's frame at coordinate 0 (a_ij); a rotary axis turns about a line
        through it
    direction : in which its body moves, or about which it turns by the right-hand rule, when the coordinate grows,
        in the lower body's frame (ISO 841: +X moves the tool in +X relative to the workpiece, so a table on the
        workpiece side moves in -X)
    """

    name: str
    low: float
    high: float
    origin_mm: Triple
    direction: Triple

    @property
    def rotary(self) -> bool:
        """Whether it turns."""
        return self.name in ROTARY_AXES

    @property
    def unit(self) -> str:
        """Unit of its coordinate, for people."""
        return "degree" if self.rotary else "mm"

    @property
    def to_internal(self) -> float:
        """Factor from its coordinate to mm or rad."""
        return math.pi / 180.0 if self.rotary else 1.0


@dataclass(frozen=True)
class Machine:
    """What a machine is. Made by `load_machine` and `parse_machine`, which check everything.

    Attributes
    ----------
    source : the TOML text that it was read from
    layout : the bodies, in the order of the lower-body array, and what they carry
    terms : the K error terms; this order is the order of every array of error terms
    """

    name: str
    source: str = field(repr=False)
    composition: Literal["motion-last", "seed"]
    reference_temperature_degC: float
    layout: Layout
    axes: dict[str, Axis]
    tool: Tool
    workpiece: Workpiece
    sensors: dict[str, Sensor]
    limits: Limits

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The bodies, bed first."""
        return self.layout.bodies

    @property
    def tool_names(self) -> tuple[str, ...]:
        """Names of the tool leaves; "tool", where there is one."""
        return tuple(self.layout.tools)

    @cached_property
    def axis_names(self) -> tuple[str, ...]:
        """Axes in the order of every array of coordinates."""
        return tuple(a for a in AXES if a in self.axes)

    @cached_property
    def axis_ends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The axes' lower and upper ends, each of shape (A,) [mm, degree]."""
        axes = [self.axes[name] for name in self.axis_names]
        return np.array([axis.low for axis in axes]), np.array([axis.high for axis in axes])

    @cached_property
    def kind(self) -> str:
        """All but the name: equal for machines that are alike, which can share what follows from it."""
        alike = (self.composition, self.reference_temperature_degC, self.layout, self.axes, self.tool, self.workpiece)
        return repr((*alike, self.sensors, self.limits))  # of floats it is exact

    @cached_property
    def terms(self) -> tuple[Term, ...]:
        """All error terms, body by body, motion before location."""
        terms: list[Term] = []
        for index, body in enumerate(self.bodies):
            if body.axis is not None:
                terms += motion_terms(body.axis, index) + location_terms(body.axis, index)
            elif body.suffix is not None:
                terms += location_terms(body.suffix, index)
        return tuple(terms)

    @cached_property
    def term_index(self) -> dict[str, int]:
        """Column of each term in an array of error terms."""
        return {term.name: k for k, term in enumerate(self.terms)}

    @cached_property
    def location_columns(self) -> list[int]:
        """Columns of the location terms in an array of error terms."""
        return [k for k, term in enumerate(self.terms) if term.kind == "location"]

    @cached_property
    def motion_columns(self) -> dict[str, list[int]]:
        """Columns of each axis' six motion terms in an array of error terms."""
        return {
            axis: [k for k, term in enumerate(self.terms) if term.kind == "motion" and term.axis == axis]
            for axis in self.axis_names
        }

    def term(self, written: str) -> Term:
        """Return the term of that name, in any of its spellings.

        Raises
        ------
        MachineError
            where the machine has no such term.
        """
        name = canonical_name(written)
        if name not in self.term_index:
            raise MachineError(
                f"unknown error term '{written}' for machine '{self.name}'" + did_you_mean(name, list(self.term_index))
            )
        return self.terms[self.term_index[name]]


def load_machine(path: str | Path) -> Machine:
    """Read a machine description from a TOML file, or from the bundle or data set folder that holds one.

    Raises
    ------
    MachineError
        with one sentence that names the file, the key, the value and what would be right.
    """
    path = Path(path)
    file = path / "machine.toml" if path.is_dir() else path
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as problem:
        raise MachineError(f"machine description '{file}' cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise MachineError(f"machine description '{file}' must be UTF-8 text") from None
    return parse_machine(text, f"machine description '{file}'")


def preset(name: str) -> Path:
    """Return the path of a machine description that comes with the package.

    Raises
    ------
    MachineError
        where there is none of that name; the message lists them.
    """
    folder = Path(str(resources.files("model") / "presets"))
    path = folder / f"{name}.toml"
    if not path.is_file():
        known = [p.stem for p in folder.glob("*.toml")]
        raise MachineError(f"unknown machine '{name}'" + did_you_mean(name, known))
    return path


def parse_machine(text: str, where: str = "machine description") -> Machine:
    """Read a machine description from TOML text; `where` names it in messages."""
    try:
        data: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError as problem:
        raise MachineError(f"{where} is not TOML: {problem}") from None
    except RecursionError:
        raise MachineError(f"{where} is not TOML that can be read: it is nested too deeply") from None
    file = check(_MachineFile, data, where, MachineError)
    layout = _layout(file, where)
    moving = {body.axis: body for body in layout.bodies if body.axis is not None}
    for name in file.axes:
        if name not in moving:
            raise MachineError(
                f"key 'axes.{name}' in {where}: the structure has no axis '{name}'" + did_you_mean(name, list(moving))
            )
    axes: dict[str, Axis] = {}
    for name, body in moving.items():
        if name not in file.axes:
            raise MachineError(f"key 'axes.{name}' is missing in {where}: give its range, such as [0.0, 800.0]")
        axes[name] = _axis(name, file.axes[name], body.side, where)
    _check_unit(file.tool.direction, "tool.direction", where)
    for name, sensor in file.sensors.items():
        low, high = sensor.range_degC
        if not low < high:
            raise MachineError(f"key 'sensors.{name}.range_degC' in {where} must rise, got [{low:g}, {high:g}]")
    return Machine(
        name=file.name,
        source=text,
        composition=file.composition,
        reference_temperature_degC=file.reference_temperature_degC,
        layout=layout,
        axes=axes,
        tool=file.tool,
        workpiece=file.workpiece,
        sensors=file.sensors,
        limits=file.limits,
    )


def _layout(file: _MachineFile, where: str) -> Layout:
    errors = {"tool_errors": file.tool.errors, "workpiece_errors": file.workpiece.errors}
    if (file.structure is None) == (file.bodies is None):
        came = "neither" if file.structure is None else "both"
        raise MachineError(f"{where} must have either 'structure' or [[bodies]], got {came}")
    if file.structure is not None:
        try:
            return parse_structure(file.structure, workpiece_axes=file.workpiece_axes, **errors)
        except MachineError as problem:
            raise MachineError(f"key 'structure' in {where}: {problem}") from None
    try:
        return lay_out([BodyEntry(b.name, b.lower, b.axis) for b in file.bodies or []], **errors)
    except MachineError as problem:
        raise MachineError(f"key 'bodies' in {where}: {problem}") from None


def _axis(name: str, file: _AxisFile, side: int, where: str) -> Axis:
    low, high = file.range
    if not low < high:
        raise MachineError(
            f"key 'axes.{name}.range' in {where} must rise, got [{low:g}, {high:g}]; write [lower, upper] in "
            f"{'degree' if name in ROTARY_AXES else 'mm'}"
        )
    x, y, z = UNIT_VECTORS[name]
    along = side or 1  # what carries both tool and workpiece has no side; it moves as it is written
    direction = file.direction or (along * x, along * y, along * z)
    _check_unit(direction, f"axes.{name}.direction", where)
    return Axis(name, low, high, file.origin_mm, direction)


def _check_unit(vector: Triple, key: str, where: str) -> None:
    length = math.hypot(*vector)
    if abs(length - 1.0) > 1e-9:
        remedy = "divide it by its length" if length > 0 else "give it a direction"
        raise MachineError(f"key '{key}' in {where} must be a unit vector, got length {length:.6g}; {remedy}")
