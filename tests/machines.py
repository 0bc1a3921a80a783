"""Machines for tests, as text."""

from itertools import permutations

ARRANGEMENTS = [
    f"w {' '.join(order[:cut])} b {' '.join(order[cut:])} t".replace("  ", " ")
    for order in permutations("XYZ")
    for cut in range(4)
]
"""All 24 arrangements of three linear axes."""


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
