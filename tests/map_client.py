"""A controller that compensates by itself: written from the description of `/map`, with nothing but its JSON."""

from typing import Any

import numpy as np

UM, URAD = 1e-3, 1e-6


def compensate(answer: dict[str, Any], positions: list[dict[str, float]], tip: Any = None) -> Any:
    """Corrected coordinates of all positions, shape (n, A), columns in the order of the answer's axes."""
    tip = answer["tool"]["offset_mm"] if tip is None else tip
    names = list(answer["axes"])
    return np.array([_solve(answer, np.array([p[a] for a in names]), tip) for p in positions])


def _solve(answer: dict[str, Any], q: Any, tip: Any) -> Any:
    wanted = _tip(answer, q, tip, errors=False)
    moves = np.stack([_tip(answer, q + step, tip, errors=False) - wanted for step in np.eye(len(q))], axis=1)
    found = q
    for _ in range(30):
        found = found - np.linalg.solve(moves, _tip(answer, found, tip, errors=True) - wanted)
    most = answer["limits"]["max_correction_um"] * UM
    return q + np.clip(found - q, -most, most)


def _tip(answer: dict[str, Any], q: Any, tip: Any, *, errors: bool) -> Any:
    coordinate = dict(zip(answer["axes"], q, strict=True))
    frames: dict[str, Any] = {}
    for body in answer["structure"]:
        if body["lower"] is None:
            frames[body["name"]] = np.eye(4)
            continue
        origin, motion = np.eye(4), np.eye(4)
        if body["axis"] is not None:
            axis = answer["axes"][body["axis"]]
            origin[:3, 3] = axis["origin_mm"]
            motion[:3, 3] = coordinate[body["axis"]] * np.array(axis["direction"])
        here = coordinate.get(body["axis"])
        of_location = _error([_value(answer, t, body["axis"], here) if errors else 0.0 for t in body["location_terms"]])
        of_motion = _error([_value(answer, t, body["axis"], here) if errors else 0.0 for t in body["motion_terms"]])
        middle = [motion, of_location] if answer["composition"] == "seed" else [of_location, motion]
        frames[body["name"]] = np.linalg.multi_dot([frames[body["lower"]], origin, *middle, of_motion])
    work, tool = frames[answer["workpiece_body"]], frames[answer["tool"]["body"]]
    return (np.linalg.inv(work) @ tool @ np.array([*tip, 1.0]))[:3]


def _value(answer: dict[str, Any], term: str, axis: str | None, here: float | None) -> float:
    served = answer["served"]
    for table, unit in (("location_um", UM), ("location_urad", URAD)):
        if term in served[table]:
            return float(served[table][term]) * unit
    table, unit = ("motion_um", UM) if term in served["motion_um"] else ("motion_urad", URAD)
    return float(np.interp(here, served["knots_mm"][axis], served[table][term])) * unit


def _error(values: list[float]) -> Any:
    x, y, z, a, b, c = values or [0.0] * 6
    turn = {
        "x": np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]]),
        "y": np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]]),
        "z": np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]),
    }
    frame = np.eye(4)
    frame[:3, :3] = turn["x"] @ turn["y"] @ turn["z"]
    frame[:3, 3] = x, y, z
    return frame
