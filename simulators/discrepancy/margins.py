"""How much evidence a name must have, and how near others must come to be one answer with it [nats]."""

import math

FALSE_ALARM_RATE = 0.01
"""Share of recordings that hide nothing in which the search may name anything at all."""
MARGIN = math.log(30.0)
"""Bayes factor beyond the penalty of looking that a name must have, or all names that tie with it together.

In noise that is known what is found by chance has a tail of χ², which of all names together passes this once in a
thousand recordings. The rest of the rate is left to noise that is not quite what it was taken for.
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
