"""A launch console: the service's client over HTTP, and what a terminal shows of it."""
