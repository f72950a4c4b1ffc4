"""Pose estimation from inertial, satellite and barometer logs. Knows no images."""
