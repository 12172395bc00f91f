"""Where operator frames come from."""
