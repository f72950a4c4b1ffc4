"""Integral images while the photos come in."""
