"""Gains for an uncertain rig: the paper's conditions as numbers, and the brake's margin."""

from inteco_abs.gain_design.advice import Advice
from inteco_abs.gain_design.assessment import Assessment, judge_gains
from inteco_abs.gain_design.harmonic_balance import Balance, Brake
from inteco_abs.gain_design.uncertainty import HARD, KNOWN, Box, ParameterRange, stated_box

__all__ = [
    "HARD",
    "KNOWN",
    "Advice",
    "Assessment",
    "Balance",
    "Box",
    "Brake",
    "ParameterRange",
    "judge_gains",
    "stated_box",
]
