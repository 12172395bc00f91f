"""The browser view of a running teleoperation."""
