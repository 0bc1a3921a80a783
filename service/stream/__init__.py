"""Streams for control loops: one WebSocket, positions in, corrections out."""
