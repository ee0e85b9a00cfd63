"""What a car is to do: paths, a stack of transforms, and the environment they make."""
