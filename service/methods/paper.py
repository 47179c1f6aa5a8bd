"""``paper``: three chained stages, each correcting what the one before left (:mod:`inertial.compensation`)."""

from __future__ import annotations

import numpy as np

from inertial.budget import Errors
from inertial.compensation import paper_chain, paper_stage
from inertial.error_model import Terms
from inertial.observability import TERMS
from service.errors import RefusedInput
from service.methods.material import Findings, Material


class Chained:
    """The paper's way."""

    def stages(self, material: Material) -> list[Terms]:
        """Return the terms after each stage there is so far."""
        _refuse_turns(material)
        physical = material.physical
        found: list[Terms] = []
        for span in material.spans:
            before = found[-1] if found else None
            stage = paper_stage(span, material.alignment, physical.site, physical.coefficients, before)
            found.append(stage.terms)
        return found

    def findings(self, material: Material) -> Findings:
        """Return all that the chain says."""
        _refuse_turns(material)
        physical, alignment, noise = material.physical, material.alignment, material.noise[-1]
        chain = paper_chain(material.spans, alignment, physical.site, physical.coefficients, noise)
        return Findings(
            stages=[stage.terms for stage in chain.stages],
            order=TERMS,
            covariance=chain.covariance,
            unseen=np.array(chain.unseen),
            unobservable=chain.unobservable,
            at_rest=chain.at_rest,
            errors=Errors.of_chain(
                chain.at_rest,
                physical.site,
                alignment.level_sigma_rad,
                alignment.azimuth_sigma_rad,
                chain.rectified_covariance,
            ),
            noise=noise,
            alignment=alignment,
        )


def _refuse_turns(material: Material) -> None:
    if any(material.turns_before(stage) for stage in range(len(material.windows))):
        raise RefusedInput(
            material.physical.name,
            "its stages stand in two attitudes, which the paper's method cannot use.",
            'Use method "optimal", or put all stages at one attitude.',
        )
