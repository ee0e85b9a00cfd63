"""A trained policy written for the car: numpy file pair, ONNX and courses, compared before."""
