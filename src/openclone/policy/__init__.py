"""What the policy sees, how it is built, and the bundle that carries it."""
