"""The runtime on the car's computer: Python 3.6, numpy 1.19, and nothing else of the package."""
