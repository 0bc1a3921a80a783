"""Machines for tests, as text."""

from itertools import permutations

ARRANGEMENTS = [
    f"w {' '.join(order[:cut])} b {' '.join(order[cut:])} t".replace("  ", " ")
    for order in permutations("XYZ")
    for cut in range(4)
]
"""All 24 arrangements of three linear axes."""


FIVE_AXIS = [
    "w C A Y X b Z t",  # trunnion table
    "w C B b X Y Z t",
    "w A Y b X Z C t",  # table and head
    "w X Y b Z C A t",  # two-axis head
    "w Y X b Z B C t",
    "w C b X Y Z B t",
    "w B Z X b Y A t",
]


def five_axis_text(structure: str, composition: str = "motion-last") -> str:
    """Return a machine with the two rotary axes of the structure, their pivots apart."""
    rotary = [a for a in "ABC" if a in structure]
    axes = "".join(
        f"[axes.{a}]\nrange = [{low}, {high}]\norigin_mm = [{x}, {y}, {z}]\n"
        for a, low, high, x, y, z in zip(
            rotary, (-110.0, -360.0), (110.0, 360.0), (20.0, -15.0), (-30.0, 8.0), (50.0, 120.0), strict=True
        )
    )
    return machine_text(structure, composition).replace("[tool]", f"{axes}[tool]")


def machine_text(
    structure: str = "w X Y b Z t", composition: str = "motion-last", *, errors: bool = True, extra: str = ""
) -> str:
    flag = str(errors).lower()
    return f"""
name = "test"
structure = "{structure}"
composition = "{composition}"
[axes.X]
range = [0.0, 800.0]
origin_mm = [10.0, -20.0, 30.0]
[axes.Y]
range = [-250.0, 250.0]
origin_mm = [0.0, 40.0, 0.0]
[axes.Z]
range = [0.0, 500.0]
origin_mm = [-5.0, 0.0, 600.0]
[tool]
offset_mm = [1.0, 2.0, -150.0]
errors = {flag}
[workpiece]
errors = {flag}
[sensors.spindle]
range_degC = [0.0, 80.0]
{extra}
"""
