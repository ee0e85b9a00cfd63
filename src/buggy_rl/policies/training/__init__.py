"""Training of a policy by PPO."""
