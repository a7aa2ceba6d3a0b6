"""Feasibility of a skill: posture, margins, clearance, speed, normal force."""
