"""Factories that compose leaves into subtrees: no algorithm, no input or output, no driver."""
