"""The ``mission`` command's own commands, by what they do; :mod:`mission.cli` puts them together."""
