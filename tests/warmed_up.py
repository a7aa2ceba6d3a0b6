"""What a station needs is read from the cache where this module is imported."""

from fmp_drake.station import WarmUp

WarmUp()
