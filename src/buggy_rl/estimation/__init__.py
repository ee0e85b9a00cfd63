"""The estimator: segments, rollouts, noise model, Gauss-Newton, cross-validation."""
