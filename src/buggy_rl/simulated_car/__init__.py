"""A simulator behind the interfaces of the real car: its own process, with faults on demand."""
