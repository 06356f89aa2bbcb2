"""The mission executive: configuration, tick loop, perception worker, run folder, report and command line."""
