"""How the policy is learned: physics, task, teacher (PPO), student (DAgger, PPO)."""
