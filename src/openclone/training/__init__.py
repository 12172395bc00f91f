"""How the policy is learned: physics, tracking task, teacher (PPO), student (DAgger)."""
