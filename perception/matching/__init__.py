"""The parts of registration (paper section 5): what is paired, how well it holds, and whether it is believed."""
