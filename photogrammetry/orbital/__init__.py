"""Rover maps and orbital images: where the one lies in the other."""
