"""Reference optima of bounded-rational channels by Blahut-Arimoto, with certificates.

`rate_distortion` solves one channel Ω → A, a concave problem with one optimum, at a price, and
`at_rate` at a rate. `serial` solves the chain Ω → X → A, which has local optima: it runs many
starts as one batch and reports them all.
All say how far above the returned objective the true optimum can lie at most.
`general` solves the chain where the action may look at the state again, at a third price.

Everything is float64 and in nats. Prices β are per nat.
"""

from bra.blahut_arimoto.discretised import Discretised, discretised
from bra.blahut_arimoto.general import general
from bra.blahut_arimoto.one_channel import rate_distortion
from bra.blahut_arimoto.rate import AtRate, at_rate
from bra.blahut_arimoto.results import AtRates, General, RateDistortion, Serial
from bra.blahut_arimoto.two_channels import serial

__all__ = [
    "AtRate",
    "AtRates",
    "Discretised",
    "General",
    "RateDistortion",
    "Serial",
    "at_rate",
    "discretised",
    "general",
    "rate_distortion",
    "serial",
]
