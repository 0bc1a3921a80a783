"""The HTTP service beside a controller: temperatures and positions in, corrected coordinates out."""
