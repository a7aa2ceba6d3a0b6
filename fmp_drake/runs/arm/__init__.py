"""A skill on an arm behind LCM messages, and a simulated arm to try it on."""
