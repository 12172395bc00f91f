"""Links to robots, simulated or real."""
