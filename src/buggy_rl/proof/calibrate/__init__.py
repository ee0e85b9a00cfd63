"""Development cases, and the weights and intervals fitted to them."""
