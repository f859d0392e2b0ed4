"""A network that has learnt the source, for all tests that begin with one."""

import pytest

from gelgap.adapt import ForceModel, Profile
from gelgap.adapt.split import split_for_training
from gelgap.adapt.trainer import train_source
from gelgap.data import ArrayFrames


@pytest.fixture(scope="session")
def stage1(source: ArrayFrames, target: ArrayFrames, profile: Profile) -> ForceModel:
    return train_source(split_for_training(source, target, profile, 0).source_train, profile, seed=0)


@pytest.fixture(scope="session")
def short(profile: Profile) -> Profile:
    return profile.replace(source_epochs=2, adapt_epochs=1)
