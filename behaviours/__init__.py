"""Thin py_trees leaves and the blackboard they share: no algorithm, no socket."""
