"""The road's adhesion, in the record of the simulated rig."""

import numpy as np

from inteco_abs.rig import RigParameters, adhesion
from inteco_abs.sessions import read_session


def test_adhesion_is_that_of_the_true_slip(quick):
    truth = quick.session.truth
    parameters = RigParameters.named("mask")
    assert truth["adhesion"].tolist() == [adhesion(slip, parameters) for slip in truth["slip"].tolist()]
    assert truth["adhesion"].max() > 0.3


def test_adhesion_of_a_drawn_rig_is_its_own(run):
    made = run('simulation.rig="hard:3"')
    truth = read_session(made.path).truth
    published = [adhesion(slip, RigParameters.named("mask")) for slip in truth["slip"].tolist()]
    assert not np.allclose(truth["adhesion"], published)
