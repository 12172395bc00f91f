"""Rotations, poses, clocks and filters."""
