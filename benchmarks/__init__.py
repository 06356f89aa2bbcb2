"""Campaigns and measurements behind the tables of the README."""
