"""One car: vehicle dynamics, contacts, lidar, time to collision."""
