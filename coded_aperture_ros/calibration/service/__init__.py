"""Correction of a camera in service, from ordinary frames: no targets, no known distances."""
