"""Reference paths: waypoints at equal spacing, as tensors that many cars can share."""
