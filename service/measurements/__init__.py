"""Probed deviations, compared with what was predicted: whether the machine is still the one that was learned."""
