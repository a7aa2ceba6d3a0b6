"""What a process does once, so that those that are forked from it need not."""

import gc

import fmp_drake.apps.arm
import fmp_drake.apps.wipe
import fmp_drake.experiments.trials  # noqa: F401
from fmp_drake.station import WarmUp

WarmUp()
gc.collect()
gc.freeze()
