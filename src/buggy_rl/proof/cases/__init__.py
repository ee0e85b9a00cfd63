"""Cases: drawn from seeds, driven, recorded and sealed."""
