"""Policies: trained by PPO or written down, their runs, scores and tables."""
