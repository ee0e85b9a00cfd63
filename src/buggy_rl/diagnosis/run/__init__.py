"""The run of a diagnosis: drives, case, budget and plan, stages, meter."""
