"""A station with loggers, its metrics, its log file."""
