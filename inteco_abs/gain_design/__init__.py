"""Gains for an uncertain rig: the paper's conditions as numbers, and the brake's margin."""

from inteco_abs.gain_design.advice import Advice
from inteco_abs.gain_design.assessment import Assessment, judge_gains
from inteco_abs.gain_design.certificate import PREDICTED, Certificate, certify, no_figure
from inteco_abs.gain_design.gains import LAWS
from inteco_abs.gain_design.harmonic_balance import Balance, Brake, identified_brake
from inteco_abs.gain_design.uncertainty import HARD, KNOWN, Box, ParameterRange, faded_share, stated_box

__all__ = [
    "HARD",
    "KNOWN",
    "LAWS",
    "PREDICTED",
    "Advice",
    "Assessment",
    "Balance",
    "Box",
    "Brake",
    "Certificate",
    "ParameterRange",
    "certify",
    "faded_share",
    "identified_brake",
    "judge_gains",
    "no_figure",
    "stated_box",
]
