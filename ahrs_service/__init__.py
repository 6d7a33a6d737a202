"""Live attitude and heading reference service for small UAVs."""
