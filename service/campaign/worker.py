"""What a local worker does first: it leaves Ctrl-C, which reaches all processes of a terminal, to the campaign.

The campaign ends its workers itself, and says what is kept. dask imports this in each worker that it starts.
"""

from __future__ import annotations

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
