"""What a practitioner would use instead of the network, tuned with the same care."""

from training.baselines.protocol import Baseline, Fitted
from training.baselines.ridge import fit_ridge

__all__ = ["Baseline", "Fitted", "fit_ridge"]
