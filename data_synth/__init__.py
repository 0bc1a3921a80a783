"""A synthetic machine shop: duty cycles, thermal network, deformation, sensors, data sets."""
