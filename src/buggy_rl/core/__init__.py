"""What every part stands on: keys, frames, parameters, configs, files, compiled functions."""
