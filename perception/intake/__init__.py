"""The parts of validation: what a scan is found out to be before anything trusts its points."""
