"""How much evidence a name must have, and how near others must come to be one answer with it [nats]."""

import math

MARGIN = math.log(100.0)
"""Bayes factor beyond the penalty of looking that a name must have, or all names that tie with it together.

Where nothing is hidden the mean Bayes factor of all that is looked at is 1, so that it is exp(MARGIN) once in a hundred
recordings at most (Markov).
"""
FURTHER = math.log(1000.0)
"""... that a further one must have beside a name that was found.

Recordings that miss two things are rarer than those that miss one, each adoption is followed by another look at the
whole recording, and the name that is right would be told beside one that is not.
"""
TIE = 3.0
"""Names whose fit is within so much of the best are one answer."""
SAME = 0.1
"""... and within so much are one column to these recordings: what lies between them is rounding."""
