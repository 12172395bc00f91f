"""OpenClone: closed-loop whole-body humanoid teleoperation from three points."""
