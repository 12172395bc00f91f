"""The stand-in for the physical robot."""
