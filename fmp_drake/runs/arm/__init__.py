"""Runs of an arm behind LCM messages, and a simulated arm to test them with."""
