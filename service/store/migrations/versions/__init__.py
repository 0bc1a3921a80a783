"""One file for each change of the tables, run in the order of their numbers."""
