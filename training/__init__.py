"""Data sets in, bundle and report out (offline; needs the train extra)."""
