"""Edited copies of a skill: tempo, position, size, harmonics; spectra."""
