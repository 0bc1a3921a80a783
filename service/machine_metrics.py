"""What Prometheus is told of the machines: a snapshot of each, and the collector that writes snapshots out.

A snapshot is taken between requests, by the loop that answers them; writing may then go on elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.machine_state import MachineState
from service.measurements.drift import Drift
from service.status import Status


@dataclass(frozen=True)
class Snapshot:
    """One machine at one moment; None where there is nothing to tell yet.

    Attributes
    ----------
    correction_um : largest correction on any axis, at the corners and the middle of the working volume
    remaining_um : bound of how far corrections are from where they move to
    telemetry_age_s : since the newest sample
    map_age_s : since corrections, or their map, were asked for last
    sensors : per sensor that the network reads, whether its last reading was believed
    drift : what probed deviations say
    """

    machine: str
    status: Status
    reliability: float
    correction_um: float | None
    remaining_um: float | None
    telemetry_age_s: float | None
    map_age_s: float | None
    sensors: dict[str, bool]
    drift: Drift
    accepted: int
    refused: int
    positions: int

    @classmethod
    def of(cls, state: MachineState) -> Snapshot:
        """Return what there is to tell of a machine now; it serves nothing and changes nothing."""
        outlook = state.outlook(state.now())
        thermal, served = state.thermal, state.served
        heard = thermal is not None and bool(thermal.tracks or thermal.faults)
        return cls(
            machine=state.machine.name,
            status=outlook.status,
            reliability=outlook.target.weight,
            correction_um=state.largest_correction_um(),
            remaining_um=None if served is None else served.remaining_um,
            telemetry_age_s=state.telemetry_age_s(outlook.now_s),
            map_age_s=None if served is None else max(state.passes(outlook.now_s) - served.time_s, 0.0),
            sensors={n: n not in thermal.faults for n in thermal.sensors} if thermal is not None and heard else {},
            drift=state.monitor.drift(state.bundle.version),
            accepted=state.counts.accepted,
            refused=state.counts.refused,
            positions=state.counts.positions,
        )


class MachineCollector(Collector):
    """Writes out the snapshots it was given last."""

    def __init__(self) -> None:
        self.snapshots: Sequence[Snapshot] = ()

    def describe(self) -> Iterable[Metric]:
        """Return the metrics without their values, for the registry's check of names."""
        return _families(())

    def collect(self) -> Iterable[Metric]:
        """Return the metrics."""
        return _families(self.snapshots)


def _families(snapshots: Sequence[Snapshot]) -> list[Metric]:
    gauges: list[tuple[str, str, Callable[[Snapshot], float | None]]] = [
        ("reliability", "How much of the thermal part counts, 0 to 1.", lambda s: s.reliability),
        ("correction_um", "Largest correction, at corners and middle.", lambda s: s.correction_um),
        ("correction_remaining_um", "How far corrections may be from where they move to.", lambda s: s.remaining_um),
        ("telemetry_age_seconds", "Since the newest telemetry sample.", lambda s: s.telemetry_age_s),
        ("error_map_age_seconds", "Since corrections or their map were asked for last.", lambda s: s.map_age_s),
    ]
    families: list[Metric] = []
    for name, text, of in gauges:
        gauge = GaugeMetricFamily(f"thermotrue_{name}", text, labels=["machine"])
        for snapshot in snapshots:
            value = of(snapshot)
            if value is not None:
                gauge.add_metric([snapshot.machine], value)
        families.append(gauge)
    labels = ["machine", "component"]
    residual = GaugeMetricFamily("thermotrue_residual_um", "Running residual of probed deviations.", labels=labels)
    limit = GaugeMetricFamily("thermotrue_residual_limit_um", "What it stays within without drift.", labels=labels)
    trend = GaugeMetricFamily("thermotrue_residual_trend_um_per_day", "Slope of the residual.", labels=labels)
    drifting = GaugeMetricFamily("thermotrue_drifting", "1 where the residual left its limit.", labels=["machine"])
    status = GaugeMetricFamily("thermotrue_status", "1 for the present status.", labels=["machine", "status"])
    sensors = GaugeMetricFamily(
        "thermotrue_sensor_ok",
        "1 where the last reading was believed, 0 where it was replaced by its estimate.",
        labels=["machine", "sensor"],
    )
    samples = CounterMetricFamily(
        "thermotrue_samples", "Telemetry samples, taken in or of no use.", labels=["machine", "outcome"]
    )
    positions = CounterMetricFamily("thermotrue_positions", "Positions compensated.", labels=["machine"])
    for snapshot in snapshots:
        _add_drift(snapshot, residual, limit, trend, drifting)
        for known in Status:
            status.add_metric([snapshot.machine, known.value], float(known == snapshot.status))
        for sensor, ok in snapshot.sensors.items():
            sensors.add_metric([snapshot.machine, sensor], float(ok))
        samples.add_metric([snapshot.machine, "accepted"], snapshot.accepted)
        samples.add_metric([snapshot.machine, "refused"], snapshot.refused)
        positions.add_metric([snapshot.machine], snapshot.positions)
    return [*families, residual, limit, trend, drifting, status, sensors, samples, positions]


def _add_drift(
    snapshot: Snapshot,
    residual: GaugeMetricFamily,
    limit: GaugeMetricFamily,
    trend: GaugeMetricFamily,
    drifting: GaugeMetricFamily,
) -> None:
    drifting.add_metric([snapshot.machine], float(snapshot.drift.drifting))
    for name, component in zip("xyz", snapshot.drift.components, strict=True):
        for family, value in (
            (residual, component.running_um),
            (limit, component.limit_um),
            (trend, component.trend_um_per_day),
        ):
            if value is not None:
                family.add_metric([snapshot.machine, name], value)
