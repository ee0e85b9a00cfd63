"""Terms: equations put together from place, signal, shape and memory, each with one coefficient."""
