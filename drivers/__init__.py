"""Bytes ⇄ samples: serial links, frame layouts, raw captures, recordings. Knows no physics."""
