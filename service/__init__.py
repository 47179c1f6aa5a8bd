"""The running system: acquisition, sequencer, store, API, reports, command line."""
