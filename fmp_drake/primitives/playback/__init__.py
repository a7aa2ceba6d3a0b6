"""Playback of skills: player, state, motion, trackers."""
