"""Classifier only: stage 2 with the contact classifier but no transfer loss, the control of class-aware methods."""

from gelgap.adapt.methods.no_transfer import NoTransfer


class ClassifierOnly(NoTransfer):
    """Regression and classification on the source: all that DSAN trains, without its loss."""

    uses_classifier = True
