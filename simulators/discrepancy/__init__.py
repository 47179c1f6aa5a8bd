"""Where simulation and measurement disagree: find it, name the missing effect, add it, show the gap shrink."""
