"""Who may ask what of the service: tokens, roles, sessions, limits (docs/security.md)."""
